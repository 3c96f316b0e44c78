enum { MOST_PARTS = 4000 };
static const double FINEST = 1e-4; /* share of the way to other positions that is one step at least */

/* Where the mechanism is asked about: laws at the positions of its drives, and what the engine says of it there. */
typedef struct {
    arm table;
    double compliance[36 * FLEXURES], offset[6 * FLEXURES], known[1 + COVARIATES];
    double passive[PASSIVE + 1], tip[16], end[16], flexed[PASSIVE + 1], twists[6 * FLEXURES], loads[6 * FLEXURES];
    double forces[ROWS + 1], displacement[6], distance, idle[ROWS * ROWS + 1], idles[ROWS * ROWS + 1];
    double room[ROOM];
    int payload;
} manipulator;
typedef double derived[6 * JOINTS];

/* ---- Where it rests --------------------------------------------------------------------------------------------- */

static void begin(manipulator *m)
{
    memset(m->passive, 0, sizeof m->passive);
}

/* Fill what the laws are at positions of the drives, in memory of this call: all of them are affine in the load. */
static void know_laws(manipulator *m, const double *q)
{
    const arm *a = arms; /* its laws are the same with every payload */
    double value[FACTORS];
    memcpy(m->compliance, a->compliance, sizeof m->compliance);
    memcpy(m->offset, a->offset, sizeof m->offset);
    m->table.compliance = m->compliance;
    m->table.offset = m->offset;
    for (int f = 0; f < FACTORS; f++) {
        const double *factor = a->factor + 6 * f;
        int column = (int)factor[1];
        value[f] = factor_at(factor, a->knots, (column < JOINTS) ? q[column] : m->known[column - JOINTS]);
    }
    for (whole c = 0; c < a->changing; c++) {
        const double *part = a->change + 45 * c;
        double times = value[(int)part[1]] * value[(int)part[2]];
        for (int b = 0; b < 6; b++) {
            m->offset[6 * (int)part[0] + b] += times * part[3 + b];
        }
        for (int b = 0; b < 36; b++) {
            m->compliance[36 * (int)part[0] + b] += times * part[9 + b];
        }
    }
}

/* Move joints without a drive to where the loops close; return whether they do. */
static int close_at(manipulator *m, const double *q, int jumps, double *passive)
{
    double *room = m->room, trial[PASSIVE + 1];
    here h = memory(&m->table, &room);
    work w = divided(&m->table, PASSIVE, 0, &room);
    memcpy(trial, passive, PASSIVE * sizeof *trial);
    if (!close_loops(&m->table, q, jumps, trial, &h, &w)) {
        return 0;
    }
    memcpy(passive, trial, PASSIVE * sizeof *trial);
    return 1;
}

/* Move them as the drives go straight from positions to others; return whether the loops close all along. */
static int follow_to(manipulator *m, const double *from, const double *q, double *passive)
{
    double done = 0.0, size = 1.0, at[JOINTS];
    for (int part = 0; (part < MOST_PARTS) && (done < 1.0); part++) {
        size = fmin(size, 1.0 - done);
        for (int j = 0; j < JOINTS; j++) {
            at[j] = (done + size < 1.0) ? from[j] + (done + size) * (q[j] - from[j]) : q[j];
        }
        if (close_at(m, at, 0, passive)) {
            done = fmin(done + size, 1.0);
            size *= 2.0;
        } else if (size < FINEST) {
            return 0;
        } else {
            size *= 0.5;
        }
    }
    return done >= 1.0;
}

/* Find them without knowing where they were: of what drives lead to from home, and q0 itself, the nearer to q0. */
static int close_first(manipulator *m, const double *q, double *passive)
{
    double led[PASSIVE + 1], straight[PASSIVE + 1], far[2] = {HUGE_VAL, HUGE_VAL};
    memcpy(led, home_passive, PASSIVE * sizeof *led);
    memcpy(straight, start_passive, PASSIVE * sizeof *straight);
    if ((HOME != 0) && follow_to(m, home, q, led)) {
        far[0] = 0.0;
    }
    if ((STRAIGHT != 0) && close_at(m, q, 1, straight)) {
        far[1] = 0.0;
    }
    for (int i = 0; i < PASSIVE; i++) {
        far[0] = fmax(far[0], fabs(led[i] - start_passive[i]));
        far[1] = fmax(far[1], fabs(straight[i] - start_passive[i]));
    }
    memcpy(passive, (far[1] < far[0]) ? straight : led, PASSIVE * sizeof *passive);
    return fmin(far[0], far[1]) < HUGE_VAL;
}

/* Come to rest from where joints without a drive were at other positions of the drives, NULL where that is not known. */
static int rest_at(manipulator *m, const double *from, const double *q)
{
    rested found = {m->passive,      m->tip,       m->flexed, m->twists, m->loads, m->forces,
                    m->displacement, &m->distance, m->idles,  m->end};
    double start[PASSIVE + 1], own[PASSIVE + 1];
    memcpy(own, m->passive, PASSIVE * sizeof *own);
    if (((from == NULL) || !follow_to(m, from, q, own)) && !close_first(m, q, own)) {
        return NOT_CLOSED;
    }
    memcpy(m->passive, own, PASSIVE * sizeof *own);
    memcpy(start, own, PASSIVE * sizeof *start);
    know_laws(m, q);
    memset(m->idle, 0, sizeof m->idle);
    return (engine_rest(&m->table, 1, q, 1, 0, start, m->idle, &found, m->room) == 1) ? FINE : NO_EQUILIBRIUM;
}

/* Return the load on a flexure where it rests. */
static const double *load_at(const manipulator *m, whole flexure)
{
    return m->loads + 6 * flexure;
}

/* The engine answers for what it has proven alone. */
static int stays(const manipulator *m)
{
    (void)m;
    return FINE;
}

/* Write where the tip of the rigid arm is. */
static int rigid_tip(manipulator *m, const double *q, double goal[3])
{
    double *room = m->room, turn[9];
    here h;
    if (!close_first(m, q, m->passive)) {
        return NOT_CLOSED;
    }
    h = memory(&m->table, &room);
    place(&m->table, q, m->passive, 0, &h);
    frame_at(&h, m->table.elements + 20 * m->table.count, turn, goal);
    return FINE;
}

/* Write the flexed tip's pose. */
static void flexed_tip(const manipulator *m, double *pose)
{
    memcpy(pose, m->end, 12 * sizeof *pose);
}

/* Write the change of the flexed tip [m] per joint about where the arm rests. */
static int derivatives(manipulator *m, const double *q, const double tip[3], derived each, double jacobian[3][JOINTS])
{
    asked ask = {0};
    (void)tip;
    ask.end = m->table.elements + 20 * m->table.count;
    ask.joints = each;
    engine_respond(&m->table, 1, q, m->flexed, m->twists, m->forces, m->idles, &ask, m->room);
    memcpy(jacobian, each, sizeof(double[3][JOINTS]));
    return FINE;
}
