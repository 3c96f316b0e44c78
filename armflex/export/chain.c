#if UNPROVEN
#define COORDINATES (6 * FLEXURES)
#endif

/* How far the iterations go. All squares are sums over the flexures' shifts [m] and turns [rad]. */
enum { MOST_STEPS = 200, PROBES = 100, FIRST_PROBES = 8 };
static const double RUNS_AWAY = 1e6;    /* by which a squared step may be longer than the one before */
static const double LARGEST_TURN = 0.1; /* rad, of a flexure */
static const double PROBE = 1e-6;       /* rad or m, by which an equilibrium is disturbed */
static const double DIFFERENCE = 1e-7;  /* rad or m, for derivatives by the joints */
#if UNPROVEN
enum { MOST_NEWTON = 50, MOST_HALVINGS = 8, PATIENCE = 3 };
static const double SLOW = 0.5;        /* of a squared step by the one before it: Newton is quicker */
static const double BALANCED = 1e-12;  /* rad or m, of an equilibrium's residual */
static const double TWISTED_BY = 1e-6; /* rad or m, for derivatives by the twists */
static const double STIFF = 1e-9;      /* part of the softest axis' compliance that a rigid one may have */
static const double LOADED_BY = 1e-6;  /* part of a load, for derivatives by it */
#endif

/* What the engine knows of the chain at one configuration. */
typedef double twists[FLEXURES][6];
typedef struct {
    arm table;
    state_one s;
    double q[JOINTS], known[1 + COVARIATES], room[ROOM];
    int payload;
#if UNPROVEN
    double matrix[COORDINATES][COORDINATES];
#endif
} chain;

/* ---- Equilibrium ------------------------------------------------------------------------------------------------ */

/* Fill the tables of the arm with a payload, without twists. */
static void describe(chain *m, const double *q, int payload)
{
    m->table = arms[payload];
    m->table.known = m->known;
    memcpy(m->q, q, sizeof m->q);
    m->payload = payload;
    m->known[0] = masses[payload];
    for (int i = 0; i < COVARIATES; i++) {
        m->known[1 + i] = NAME_covariates[i];
    }
    m->s = divide_one(&m->table, m->room);
    for (int k = 0; k < FLEXURES; k++) {
        m->s.f[k].apart = 0;
        for (int b = 0; b < 6; b++) {
            m->s.f[k].twist[b] = 0.0;
        }
    }
}

static void twists_of(const chain *m, twists twist)
{
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(twist[k], m->s.f[k].twist, sizeof twist[k]);
    }
}

static void set_twists(chain *m, twists twist)
{
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(m->s.f[k].twist, twist[k], sizeof twist[k]);
    }
}

/* Fill the twists that the laws give under the loads at those that are there; return the squared step to them. */
static double step_of(chain *m)
{
    double square = 0.0;
    (void)weigh_one(&m->table, &m->s, 1, 0, NULL);
    deform_one(&m->table, &m->s, 0);
    for (int k = 0; k < FLEXURES; k++) {
        for (int b = 0; b < 6; b++) {
            double step = m->s.f[k].next[b] - m->s.f[k].twist[b];
            square += step * step;
        }
    }
    return square;
}

/* Move the twists to rest: the fixed point of loads and laws, which stiff arms are drawn to in a few steps. A squared
 * step may, after some, be so many times as long as the one before it. */
static int draw(chain *m, double slowest, int patience)
{
    double before = HUGE_VAL;
    for (int step = 0; step < MOST_STEPS; step++) {
        double square = step_of(m);
        for (int k = 0; k < FLEXURES; k++) {
            memcpy(m->s.f[k].twist, m->s.f[k].next, sizeof m->s.f[k].twist);
        }
        if ((step > 0) && (square <= CONVERGED) && (square * square <= NEXT * before)) {
            return FINE;
        }
        if (!(square < slowest * before) && (step >= patience)) { /* not a number is not less, either */
            break;
        }
        before = square;
    }
    return NO_EQUILIBRIUM;
}
#if UNPROVEN

static double dot6(const double *a, const double *b)
{
    return dot_one(a, b) + dot_one(a + 3, b + 3);
}

/* Write the change of the loads per change of the twists. */
static void loads_by_twist(chain *m)
{
    twists load;
    (void)weigh_one(&m->table, &m->s, 1, 0, NULL);
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(load[k], m->s.f[k].load, sizeof load[k]);
    }
    for (int j = 0; j < COORDINATES; j++) {
        double *twist = &m->s.f[j / 6].twist[j % 6], kept = *twist;
        *twist = kept + TWISTED_BY;
        (void)weigh_one(&m->table, &m->s, 1, 0, NULL);
        *twist = kept;
        for (int i = 0; i < COORDINATES; i++) {
            m->matrix[i][j] = (m->s.f[i / 6].load[i % 6] - load[i / 6][i % 6]) / TWISTED_BY;
        }
    }
    (void)weigh_one(&m->table, &m->s, 1, 0, NULL);
}

/* Write the change of every flexure's twist per change of its load: the tangents of the laws. */
static void twists_by_load(chain *m, double by[FLEXURES][6][6])
{
    twists here;
    deform_one(&m->table, &m->s, 0);
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(here[k], m->s.f[k].next, sizeof here[k]);
    }
    for (int b = 0; b < 6; b++) {
        double kept[FLEXURES], step[FLEXURES];
        for (int k = 0; k < FLEXURES; k++) {
            double least = 1.0, *load = m->s.f[k].load;
            for (int a = 0; a < 6; a++) {
                least = fmax(least, fabs(load[a]));
            }
            kept[k] = load[b];
            step[k] = LOADED_BY * fmax(fabs(kept[k]), 1e-3 * least);
            load[b] += step[k];
        }
        deform_one(&m->table, &m->s, 0);
        for (int k = 0; k < FLEXURES; k++) {
            m->s.f[k].load[b] = kept[k];
            for (int a = 0; a < 6; a++) {
                by[k][a][b] = (m->s.f[k].next[a] - here[k][a]) / step[k];
            }
        }
    }
}

/* Multiply the rows of every flexure in the matrix by minus a matrix of its own, and add the unit matrix. */
static void complete(chain *m, double by[FLEXURES][6][6])
{
    for (int k = 0; k < FLEXURES; k++) {
        for (int j = 0; j < COORDINATES; j++) {
            double column[6];
            for (int b = 0; b < 6; b++) {
                column[b] = m->matrix[6 * k + b][j];
            }
            for (int a = 0; a < 6; a++) {
                m->matrix[6 * k + a][j] = ((6 * k + a == j) ? 1.0 : 0.0) - dot6(by[k][a], column);
            }
        }
    }
}

/* Solve the linear system of the matrix, by Gauss with the largest pivots. */
static int solved(chain *m, double right[COORDINATES])
{
    for (int k = 0; k < COORDINATES; k++) {
        int best = k;
        double swap;
        for (int i = k + 1; i < COORDINATES; i++) {
            best = (fabs(m->matrix[i][k]) > fabs(m->matrix[best][k])) ? i : best;
        }
        if (!(fabs(m->matrix[best][k]) > 0.0)) {
            return NO_EQUILIBRIUM;
        }
        for (int j = k; j < COORDINATES; j++) {
            swap = m->matrix[k][j];
            m->matrix[k][j] = m->matrix[best][j];
            m->matrix[best][j] = swap;
        }
        swap = right[k];
        right[k] = right[best];
        right[best] = swap;
        for (int i = k + 1; i < COORDINATES; i++) {
            double times = m->matrix[i][k] / m->matrix[k][k];
            for (int j = k + 1; j < COORDINATES; j++) {
                m->matrix[i][j] -= times * m->matrix[k][j];
            }
            right[i] -= times * right[k];
        }
    }
    for (int k = COORDINATES - 1; k >= 0; k--) {
        for (int i = k + 1; i < COORDINATES; i++) {
            right[k] -= m->matrix[k][i] * right[i];
        }
        right[k] /= m->matrix[k][k];
    }
    return FINE;
}

/* Write how far the laws would move the twists; return the farthest of all, endless where it is no number. */
static double residual(chain *m, twists left)
{
    double largest = 0.0;
    (void)step_of(m);
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            left[k][a] = m->s.f[k].next[a] - m->s.f[k].twist[a];
            largest = (fabs(left[k][a]) < HUGE_VAL) ? fmax(largest, fabs(left[k][a])) : HUGE_VAL;
        }
    }
    return largest;
}

/* Move the twists to rest by Newton's method, whose steps are halved until the residual shrinks. */
static int newton(chain *m)
{
    twists left, from;
    double by[FLEXURES][6][6], step[COORDINATES], largest = residual(m, left);
    int polished = 0;
    for (int pass = 0; pass < MOST_NEWTON; pass++) {
        double factor = 1.0, before = largest, most = 0.0;
        if (!(largest < HUGE_VAL) || ((largest <= BALANCED) && ((polished != 0) || (largest <= 0.01 * BALANCED)))) {
            break;
        }
        polished = (largest <= BALANCED) ? 1 : 0;
        loads_by_twist(m);
        twists_by_load(m, by);
        complete(m, by);
        for (int j = 0; j < COORDINATES; j++) {
            step[j] = left[j / 6][j % 6];
        }
        twists_of(m, from);
        if (solved(m, step) != FINE) {
            return NO_EQUILIBRIUM;
        }
        for (int j = 0; j < COORDINATES; j++) {
            most = fmax(most, fabs(step[j]));
        }
        factor = fmin(1.0, 1.0 / fmax(most, 1e-300)); /* a turn must not come near pi */
        for (int half = 0; half < MOST_HALVINGS; half++) {
            for (int j = 0; j < COORDINATES; j++) {
                m->s.f[j / 6].twist[j % 6] = from[j / 6][j % 6] + factor * step[j];
            }
            largest = residual(m, left);
            if ((largest < before) || (before < 10.0 * BALANCED)) {
                break;
            }
            factor *= 0.5;
        }
    }
    return (largest <= BALANCED) ? FINE : NO_EQUILIBRIUM;
}

/* Factor a positive matrix into a lower triangle times its transpose, in place; return whether it is positive. Its
 * columns begin at the first. */
static int factored(double matrix[][COORDINATES], int first, int size)
{
    for (int k = 0; k < size; k++) {
        for (int j = 0; j <= k; j++) {
            double sum = matrix[k][first + j];
            for (int c = 0; c < j; c++) {
                sum -= matrix[k][first + c] * matrix[j][first + c];
            }
            if (j < k) {
                matrix[k][first + j] = sum / matrix[j][first + j];
            } else if (sum > 0.0) {
                matrix[k][first + k] = sqrt(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}

/* Return whether the energy has its least where the arm rests: with C = L L' of every flexure's law, and G the change
 * of minus the loads by the twists, I + L' G L is positive. For a law that is not symmetric this is enough, and more. */
static int least_energy(chain *m)
{
    double by[FLEXURES][6][6], root[6][COORDINATES]; /* the triangles of all flexures beside each other */
    loads_by_twist(m);
    twists_by_load(m, by);
    for (int k = 0; k < FLEXURES; k++) {
        double given[6][6];
        for (int a = 0; a < 6; a++) {
            int first = (a < 3) ? 0 : 3;
            double softest = fmax(fmax(by[k][first][first], by[k][first + 1][first + 1]), by[k][first + 2][first + 2]);
            for (int b = 0; b < 6; b++) {
                given[a][b] = by[k][a][b];
                root[a][6 * k + b] = 0.5 * (by[k][a][b] + by[k][b][a]);
            }
            root[a][6 * k + a] += STIFF * fmax(softest, STIFF * STIFF);
        }
        if (factored(root, 6 * k, 6) == 0) {
            return 0;
        }
        for (int b = 0; b < 6; b++) { /* the triangle's inverse times the law's tangent */
            for (int a = 0; a < 6; a++) {
                double sum = given[a][b];
                for (int c = 0; c < a; c++) {
                    sum -= root[a][6 * k + c] * by[k][c][b];
                }
                by[k][a][b] = sum / root[a][6 * k + a];
            }
        }
    }
    for (int i = 0; i < COORDINATES; i++) {
        for (int k = 0; k < FLEXURES; k++) {
            for (int b = 0; b < 6; b++) {
                double sum = 0.0;
                for (int c = b; c < 6; c++) {
                    sum += m->matrix[i][6 * k + c] * root[c][6 * k + b];
                }
                m->matrix[i][6 * k + b] = sum;
            }
        }
    }
    complete(m, by);
    for (int i = 0; i < COORDINATES; i++) {
        for (int j = 0; j < i; j++) {
            m->matrix[i][j] = 0.5 * (m->matrix[i][j] + m->matrix[j][i]);
        }
    }
    return factored(m->matrix, 0, COORDINATES);
}
#endif

/* Bring the arm to rest at joint positions, from the twists that are there. */
static int rest_at(chain *m)
{
    int code;
#if UNPROVEN
    twists begin_at;
#endif
    place_one(&m->table, &m->s, 1, m->q, 0);
    know_one(&m->table, &m->s, 1, m->q, 0);
#if UNPROVEN
    twists_of(m, begin_at);
    code = draw(m, SLOW, PATIENCE);
    for (int trial = 0; (trial < 2) && (code != FINE); trial++) { /* a law that is not smooth is no matter for Newton */
        set_twists(m, begin_at);
        code = (trial == 0) ? newton(m) : draw(m, RUNS_AWAY, 1);
    }
#else
    code = draw(m, RUNS_AWAY, 1);
#endif
    for (int k = 0; (code == FINE) && (k < FLEXURES); k++) {
        const double *turn = &m->s.f[k].twist[3];
        if (!(dot_one(turn, turn) <= LARGEST_TURN * LARGEST_TURN)) {
            code = TOO_LARGE;
        }
    }
    return code;
}

/* Return whether the arm would stay where it rests: a small disturbance must shrink. It is turned by every probe to the
 * direction that shrinks least. Where the weight can never soften the arm so much, nothing need be tried. */
static int stays(chain *m)
{
    twists rest, off;
    double ratio = 1.0;
    if (proven[m->payload] != 0) {
        return FINE;
    }
    (void)step_of(m);
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            rest[k][a] = m->s.f[k].next[a];
            off[k][a] = PROBE * (1.0 + 0.1 * (double)((5 * k + 3 * a) % 7)) * (((k + a) % 2 == 0) ? 1.0 : -1.0);
        }
    }
    for (int probe = 0; probe < PROBES; probe++) {
        double square = 0.0, length;
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                m->s.f[k].twist[a] = rest[k][a] + off[k][a];
            }
        }
        (void)step_of(m);
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                off[k][a] = m->s.f[k].next[a] - rest[k][a];
                square += off[k][a] * off[k][a];
            }
        }
        length = sqrt(square);
        ratio = length / PROBE;
        if (!(length > 1e-9 * PROBE) || ((probe >= FIRST_PROBES) && (ratio < 0.5))) {
            break; /* it shrinks to nothing, or quickly */
        }
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                off[k][a] *= PROBE / length;
            }
        }
    }
    set_twists(m, rest);
#if UNPROVEN
    if (!(ratio < 1.0) && (least_energy(m) != 0)) { /* it is stiffened by the load, and swings from probe to probe */
        ratio = 0.0;
    }
#endif
    return (ratio < 1.0) ? FINE : NO_EQUILIBRIUM;
}

/* Write where the flexed arm's tip is [m]. */
static void flexed_tip(chain *m, double tip[3])
{
    displace_one(&m->table, &m->s);
    for (int i = 0; i < 3; i++) {
        tip[i] = m->s.tip[i] + m->s.pull[i];
    }
}

/* ---- Tip -------------------------------------------------------------------------------------------------------- */

/* Write where the flexed arm's tip is at joint positions q under a payload.
 *
 * q: NAME_nq numbers [rad or m], in the order of NAME_joints. payload: its place in NAME_payloads.
 * pose: 12 numbers, rotation and origin [m] in the base frame as a 3 x 4 matrix row by row.
 * Returns 0, or one of the codes above; pose is then untouched. */
int NAME_tip(const double *q, int payload, double *pose)
{
    chain m;
    int code = check(q, payload);
    if (code != FINE) {
        return code;
    }
    describe(&m, q, payload);
    code = rest_at(&m);
    if (code == FINE) {
        code = stays(&m);
    }
    if (code == FINE) {
        const double *u = m.s.quaternion, *own = m.table.elements + 20 * m.table.count;
        double tip[3];
        flexed_tip(&m, tip);
        for (int j = 0; j < 3; j++) {
            double axis[3], once[3], twice[3]; /* of the tip, turned by a quaternion */
            for (int i = 0; i < 3; i++) {
                const double *turn = m.s.tip_turn + 3 * i;
                axis[i] = turn[0] * own[j] + turn[1] * own[3 + j] + turn[2] * own[6 + j];
            }
            cross_one(u + 1, axis, once);
            cross_one(u + 1, once, twice);
            for (int i = 0; i < 3; i++) {
                pose[4 * i + j] = axis[i] + 2.0 * (u[0] * once[i] + twice[i]);
            }
            pose[4 * j + 3] = tip[j];
        }
    }
    return code;
}

/* The same: a chain carries nothing from call to call, and `state` may be NULL. */
int NAME_follow(const double *q, int payload, double *state, double *pose)
{
    (void)state;
    return NAME_tip(q, payload, pose);
}

/* ---- Compensation ----------------------------------------------------------------------------------------------- */

/* Write the change of the flexed tip [m] per joint about where the arm rests: it comes to rest again. `slope` holds the
 * change of the twists per joint from one time to the next, to begin near where that will be. */
static int derivatives(chain *m, const double tip[3], twists slope[JOINTS], double jacobian[3][JOINTS])
{
    twists rest;
    int code = FINE;
    twists_of(m, rest);
    for (int j = 0; (j < JOINTS) && (code == FINE); j++) {
        double end[3], at = m->q[j];
        m->q[j] = at + DIFFERENCE;
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                m->s.f[k].twist[a] = rest[k][a] + DIFFERENCE * slope[j][k][a];
            }
        }
        code = rest_at(m);
        flexed_tip(m, end);
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                slope[j][k][a] = (m->s.f[k].twist[a] - rest[k][a]) / DIFFERENCE;
            }
        }
        m->q[j] = at;
        for (int i = 0; i < 3; i++) {
            jacobian[i][j] = (end[i] - tip[i]) / DIFFERENCE;
        }
    }
    set_twists(m, rest);
    return code;
}

/* Write the joint positions nearest to q whose flexed tip is where the rigid arm's is at q, as the controller knows the
 * rigid arm; the orientation follows. Arguments as of NAME_tip; out: NAME_nq joint positions [rad or m], untouched
 * where a code is returned. `out` may be `q`. */
int NAME_compensate(const double *q, int payload, double *out)
{
    chain m;
    double goal[3], tip[3], change[JOINTS] = {0.0}, jacobian[3][JOINTS], length = HUGE_VAL;
    twists slope[JOINTS] = {{{0.0}}};
    int code = check(q, payload);
    if (code != FINE) {
        return code;
    }
    describe(&m, q, payload);
/*@nominal*/
    place_one(&m.table, &m.s, 1, q, 0);
    memcpy(goal, m.s.tip, sizeof goal);
    describe(&m, q, payload);
    for (int jump = 0; jump <= MOST_JUMPS; jump++) {
        for (int j = 0; j < JOINTS; j++) {
            m.q[j] = q[j] + change[j];
        }
        code = rest_at(&m);
        if (code != FINE) {
            return code;
        }
        flexed_tip(&m, tip);
        if (arrived(goal, tip, length, jump)) {
            break;
        }
        code = (jump < MOST_JUMPS) ? derivatives(&m, tip, slope, jacobian) : UNREACHED;
        if (code != FINE) {
            return code;
        }
        length = aim(q, goal, tip, jacobian, jump, change);
    }
    code = stays(&m);
    if (code == FINE) {
        memcpy(out, m.q, sizeof m.q);
    }
    return code;
}
