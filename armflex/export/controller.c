/*@head*/

#define CONTROLLER 1
#define PLAIN 1
/*@engine*/
/* ---- Interface ------------------------------------------------------------------------------------------------- */

extern const int NAME_nq;                        /* how many drives there are */
extern const int NAME_nstate;                    /* numbers that NAME_follow carries from call to call */
extern const char *const NAME_joints[];          /* names of the drives, the order of q; NULL at the end */
extern const char *const NAME_passive[];         /* of the joints without a drive */
extern const char *const NAME_payloads[];        /* names of the payloads, by their numbers; NULL at the end */
extern const char *const NAME_covariate_names[]; /* what the laws depend on beside q and the payload; NULL at the end */
extern double NAME_covariates[];                 /* their values, SI and degrees Celsius: NaN until you set them; what
                                                  * flexures remember may stay NaN, see NAME_follow */

int NAME_tip(const double *q, int payload, double *pose);
int NAME_follow(const double *q, int payload, double *state, double *pose);
int NAME_compensate(const double *q, int payload, double *out);

enum {
    FINE = 0,
    NOT_FINITE = 1,     /* a position, a number of the state or a covariate is no number, or beyond 1000 rad or m */
    OUTSIDE_LIMITS = 2, /* a joint is beyond its limits */
    NO_PAYLOAD = 3,     /* there is no payload of this number */
    NO_EQUILIBRIUM = 4, /* it comes to rest nowhere near, or would not stay there; with loops also what is TOO_LARGE */
    TOO_LARGE = 5,      /* a flexure turns by more than 0.1 rad, which no compliance describes */
    UNREACHED = 6,      /* NAME_compensate alone: no joint positions near q and within the limits bring the tip there */
    NOT_CLOSED = 7      /* the loops do not close there, or the joints without a drive could stand anywhere */
};

/* ---- Constants: SI units ---------------------------------------------------------------------------------------- */

/*@constants*/
static const double LARGEST = 1000.0, BEYOND = 1e-9; /* of a position; beyond its limits by rounding alone */
static const double LARGEST_LOAD = 1e12;             /* N or Nm, that a flexure remembers */
static const double LARGEST_CHANGE = 0.5;            /* rad or m, of a joint by NAME_compensate */
static const double REACHED = 1e-11;                 /* m, of each coordinate of the tip */
static const double SETTLED = 1e-8;                  /* rad or m, of the last change of the joints */
static const double DAMPING = 1e-14;                 /* m^2, of the tip's Jacobian times its transpose */
enum { MOST_JUMPS = 20, MOST_AIMS = 15, WHOLE_AIMS = 5 };

/* Return whether what a flexure remembers is not set from outside: only NaN is not itself. */
static int is_carried(int play)
{
    double value = NAME_covariates[remembered[play][0]];
    return !((value <= 0.0) || (value > 0.0));
}

/* Return a code for arguments that cannot be answered. */
static int check(const double *q, int payload)
{
    int covariate[COVARIATES + 1] = {0}; /* whether it may be NaN */
    if ((payload < 0) || (payload >= PAYLOADS)) {
        return NO_PAYLOAD;
    }
    for (int i = 0; i < PLAYS; i++) {
        covariate[remembered[i][0]] = is_carried(i);
    }
    for (int i = 0; i < COVARIATES; i++) {
        if (!(fabs(NAME_covariates[i]) < HUGE_VAL) && (covariate[i] == 0)) {
            return NOT_FINITE;
        }
    }
    for (int j = 0; j < JOINTS; j++) {
        if (!(fabs(q[j]) <= LARGEST)) {
            return NOT_FINITE;
        }
    }
    for (int j = 0; j < JOINTS; j++) {
        if ((q[j] < limits[j][0] - BEYOND) || (q[j] > limits[j][1] + BEYOND)) {
            return OUTSIDE_LIMITS;
        }
    }
    return FINE;
}

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

/* Add to the change of the joints what brings the tip to its goal, to first order: the smallest change in all that does,
 * or, where these go round in circles, a further one. Return the largest of any joint. */
static double aim(const double *q, const double *goal, const double *tip, double jacobian[3][JOINTS], int jump,
                  double *change)
{
    double wanted[3], by[JOINTS] = {0.0}, from[JOINTS], low[JOINTS], high[JOINTS], length = 0.0;
    for (int j = 0; j < JOINTS; j++) {
        from[j] = (jump < WHOLE_AIMS) ? 0.0 : ((jump < MOST_AIMS) ? 0.5 * change[j] : change[j]);
        low[j] = fmin(fmax(-LARGEST_CHANGE, limits[j][0] - q[j]), 0.0) - from[j];
        high[j] = fmax(fmin(LARGEST_CHANGE, limits[j][1] - q[j]), 0.0) - from[j];
    }
    for (int i = 0; i < 3; i++) {
        wanted[i] = goal[i] - tip[i];
        for (int j = 0; j < JOINTS; j++) {
            wanted[i] += jacobian[i][j] * (change[j] - from[j]);
        }
    }
    smallest_change(jacobian, wanted, low, high, by);
    for (int j = 0; j < JOINTS; j++) {
        length = fmax(length, fabs(from[j] + by[j] - change[j]));
        change[j] = from[j] + by[j];
    }
    return length;
}

/* Return whether the tip is at its goal, and the joints need not be moved any more to be the nearest that bring it there:
 * `last` is their last change. */
static int arrived(const double *goal, const double *tip, double last, int jump)
{
    double left = 0.0;
    for (int i = 0; i < 3; i++) {
        left = fmax(left, fabs(goal[i] - tip[i]));
    }
    return (left <= REACHED) && ((last <= SETTLED) || (jump > MOST_AIMS));
}

/*@mechanics*/

/* ---- Tip -------------------------------------------------------------------------------------------------------- */

/* Fill the tables of the arm with a payload, and where it begins. */
static void describe(manipulator *m, int payload)
{
    m->table = arms[payload];
    m->table.known = m->known;
    m->payload = payload;
    m->known[0] = masses[payload];
    for (int i = 0; i < COVARIATES; i++) {
        m->known[1 + i] = NAME_covariates[i];
    }
    begin(m);
}

/* Bring the arm to rest with what its flexures remember: each drags along the load at its place, as that is without
 * what is remembered, once it is a radius away. `plays` is what they remembered before, and is what they do then. */
static int rest_remembering(manipulator *m, const double *from, const double *q, double *plays)
{
    int code, carried = 0;
    for (int i = 0; i < PLAYS; i++) {
        if (is_carried(i)) {
            m->known[1 + remembered[i][0]] = 0.0;
            carried = 1;
        }
    }
    code = rest_at(m, from, q);
    if ((code != FINE) || (carried == 0)) {
        return code;
    }
    for (int i = 0; i < PLAYS; i++) {
        if (is_carried(i)) {
            const double *wrench = load_at(m, remembered[i][1]);
            double load = 0.0;
            for (int a = 0; a < 6; a++) {
                load += plays_of[i][a] * wrench[a];
            }
            plays[i] = fmin(fmax(plays[i], load - plays_of[i][6]), load + plays_of[i][6]);
            m->known[1 + remembered[i][0]] = plays[i];
        }
    }
    return rest_at(m, q, q);
}

/* Write where the flexed arm's tip is at positions q of the drives under a payload.
 *
 * q: NAME_nq numbers [rad or m], in the order of NAME_joints. payload: its place in NAME_payloads.
 * state: NAME_nstate numbers: of an arm with loops whether it was asked before, the drives and the joints without one
 * then; and what flexures remember, but for what is set among the covariates. All 0 to begin from each passive joint's
 * q0, unloaded. Written when it returns 0. Where NAME_nstate is 0 it may be NULL.
 * pose: 12 numbers, rotation and origin [m] in the base frame as a 3 x 4 matrix row by row.
 * Returns 0, or one of the codes above; state and pose are then untouched. */
int NAME_follow(const double *q, int payload, double *state, double *pose)
{
    manipulator m;
    const double *from = NULL;
    double plays[PLAYS + 1];
    int code = check(q, payload);
    for (int i = 0; (i < STATE) && (code == FINE); i++) {
        code = (fabs(state[i]) <= ((i < STANDING) ? LARGEST : LARGEST_LOAD)) ? FINE : NOT_FINITE;
    }
    if (code != FINE) {
        return code;
    }
    describe(&m, payload);
    if ((STANDING > 0) && (state[0] != 0.0)) {
        from = state + 1;
        memcpy(m.passive, state + 1 + JOINTS, PASSIVE * sizeof *state);
    }
    for (int i = 0; i < PLAYS; i++) {
        plays[i] = state[STANDING + i];
    }
    code = rest_remembering(&m, from, q, plays);
    if (code == FINE) {
        code = stays(&m);
    }
    if (code == FINE) {
        flexed_tip(&m, pose);
        for (int i = 0; i < PLAYS; i++) {
            state[STANDING + i] = plays[i];
        }
        if (STANDING > 0) {
            state[0] = 1.0;
            memcpy(state + 1, q, JOINTS * sizeof *state);
            memcpy(state + 1 + JOINTS, m.passive, PASSIVE * sizeof *state);
        }
    }
    return code;
}

/* The same without a state: from each passive joint's q0, and each load put on once, from nothing. */
int NAME_tip(const double *q, int payload, double *pose)
{
    double state[STATE + 1] = {0.0};
    return NAME_follow(q, payload, state, pose);
}

/* ---- Compensation ----------------------------------------------------------------------------------------------- */

/* Write the positions of the drives nearest to q whose flexed tip is where the rigid arm's is at q, as the controller
 * knows the rigid arm; the orientation follows. Arguments as of NAME_tip; out: NAME_nq positions [rad or m], untouched
 * where a code is returned. `out` may be `q`. */
int NAME_compensate(const double *q, int payload, double *out)
{
    manipulator m;
    derived work_of;
    double goal[3], pose[12], tip[3], change[JOINTS] = {0.0}, at[JOINTS], before[JOINTS], jacobian[3][JOINTS];
    double length = HUGE_VAL;
    int code = check(q, payload);
    if (code != FINE) {
        return code;
    }
    memset(work_of, 0, sizeof work_of);
    describe(&m, payload);
/*@nominal*/
    code = rigid_tip(&m, q, goal);
    if (code != FINE) {
        return code;
    }
    describe(&m, payload);
    for (int jump = 0; jump <= MOST_JUMPS; jump++) {
        double plays[PLAYS + 1] = {0.0};
        for (int j = 0; j < JOINTS; j++) {
            at[j] = q[j] + change[j];
        }
        code = rest_remembering(&m, (jump > 0) ? before : NULL, at, plays);
        if (code != FINE) {
            return code;
        }
        memcpy(before, at, sizeof before);
        flexed_tip(&m, pose);
        for (int i = 0; i < 3; i++) {
            tip[i] = pose[4 * i + 3];
        }
        if (arrived(goal, tip, length, jump)) {
            break;
        }
        code = (jump < MOST_JUMPS) ? derivatives(&m, at, tip, work_of, jacobian) : UNREACHED;
        if (code != FINE) {
            return code;
        }
        length = aim(q, goal, tip, jacobian, jump, change);
    }
    code = stays(&m);
    if (code == FINE) {
        memcpy(out, at, sizeof at);
    }
    return code;
}
