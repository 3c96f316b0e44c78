/* Write the smallest change of the joints within a box that moves the linearised tip by `wanted`: joints that would
 * leave the box are held at its side, and the others do the rest. */
static void smallest_change(double jacobian[3][JOINTS], const double *wanted, double low[JOINTS], double high[JOINTS],
                            double change[JOINTS])
{
    int held[JOINTS] = {0};
    for (int pass = 0; pass <= JOINTS; pass++) {
        double a[3][4], most = 0.0; /* of the joints that are free, J J' and what they have to do */
        int worst = -1;
        for (int i = 0; i < 3; i++) {
            for (int k = 0; k < 4; k++) {
                a[i][k] = (k == 3) ? wanted[i] : ((i == k) ? DAMPING : 0.0);
            }
            for (int j = 0; j < JOINTS; j++) {
                for (int k = 0; (k < 3) && (held[j] == 0); k++) {
                    a[i][k] += jacobian[i][j] * jacobian[k][j];
                }
                if (held[j] != 0) {
                    a[i][3] -= jacobian[i][j] * change[j];
                }
            }
        }
        for (int i = 0; i < 3; i++) { /* positive: elimination needs no exchange of rows */
            for (int k = i + 1; k < 3; k++) {
                double times = a[k][i] / a[i][i];
                for (int c = i; c < 4; c++) {
                    a[k][c] -= times * a[i][c];
                }
            }
        }
        for (int i = 2; i >= 0; i--) {
            for (int k = i + 1; k < 3; k++) {
                a[i][3] -= a[i][k] * a[k][3];
            }
            a[i][3] /= a[i][i];
        }
        for (int j = 0; j < JOINTS; j++) {
            if (held[j] == 0) {
                double beyond;
                change[j] = jacobian[0][j] * a[0][3] + jacobian[1][j] * a[1][3] + jacobian[2][j] * a[2][3];
                beyond = fmax(low[j] - change[j], change[j] - high[j]);
                if (beyond > most) {
                    most = beyond;
                    worst = j;
                }
            }
        }
        if (worst < 0) {
            break;
        }
        change[worst] = (change[worst] < low[worst]) ? low[worst] : high[worst];
        held[worst] = 1;
    }
}
