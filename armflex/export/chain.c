/* How far the iterations go. All squares are sums over the flexures' shifts [m] and turns [rad]. */
enum { MOST_STEPS = 200, PROBES = 100, FIRST_PROBES = 8 };
static const double RUNS_AWAY = 1e6;    /* by which a squared step may be longer than the one before */
static const double LARGEST_TURN = 0.1; /* rad, of a flexure */
static const double PROBE = 1e-6;       /* rad or m, by which an equilibrium is disturbed */
static const double DIFFERENCE = 1e-7;  /* rad or m, for derivatives by the joints */
#if !defined(PROVEN)
enum { COORDINATES = 6 * FLEXURES, SIDE = (COORDINATES + WIDE - 1) / WIDE * WIDE };
enum { MOST_NEWTON = 50, MOST_HALVINGS = 8, PATIENCE = 3 };
static const double SLOW = 0.5;        /* of a squared step by the one before it: Newton is quicker */
static const double BALANCED = 1e-12;  /* rad or m, of an equilibrium's residual */
static const double TWISTED_BY = 1e-6; /* rad or m, for derivatives by the twists */
static const double STIFF = 1e-9;      /* part of the softest axis' compliance that a rigid one may have */
static const double LOADED_BY = 1e-6;  /* part of a load, for derivatives by it */
#endif /* PROVEN */

/* What the engine knows of the chain at one configuration. */
typedef double twists[FLEXURES][6];
typedef twists derived[JOINTS]; /* per joint */
typedef struct {
    arm table;
    state_one s;
    double known[1 + COVARIATES], passive[PASSIVE + 1], room[ROOM];
    int payload;
#if !defined(PROVEN)
    double matrix[COORDINATES + 1][SIDE]; /* the last row is worked in */
#endif /* PROVEN */
} manipulator;

/* ---- Equilibrium ------------------------------------------------------------------------------------------------ */

/* Without twists. */
static void begin(manipulator *m)
{
    m->s = divide_one(&m->table, m->room);
    for (int k = 0; k < FLEXURES; k++) {
        m->s.f[k].apart = 0;
        memset(m->s.f[k].twist, 0, sizeof m->s.f[k].twist);
    }
}

static void twists_of(const manipulator *m, twists twist)
{
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(twist[k], m->s.f[k].twist, sizeof twist[k]);
    }
}

static void set_twists(manipulator *m, twists twist)
{
    for (int k = 0; k < FLEXURES; k++) {
        memcpy(m->s.f[k].twist, twist[k], sizeof twist[k]);
    }
}

/* Fill the twists that the laws give under the loads at those that are there; return the squared step to them. */
static double step_of(manipulator *m)
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
static int draw(manipulator *m, double slowest, int patience)
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
#if !defined(PROVEN)

/* Write the change of the loads per change of the twists. */
static void loads_by_twist(manipulator *m)
{
    twists load;
    memset(m->matrix, 0, sizeof m->matrix);
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
static void twists_by_load(manipulator *m, double by[FLEXURES][6][6])
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
static void complete(manipulator *m, double by[FLEXURES][6][6])
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

/* Write how far the laws would move the twists; return the farthest of all, endless where it is no number. */
static double residual(manipulator *m, twists left)
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
static int newton(manipulator *m)
{
    twists left, from;
    double by[FLEXURES][6][6], largest = residual(m, left);
    int polished = 0;
    for (int pass = 0; pass < MOST_NEWTON; pass++) {
        double share = 1.0, before = largest, most = 0.0, step[COORDINATES][WIDE] = {{0.0}};
        whole order[COORDINATES];
        if (!(largest < HUGE_VAL) || ((largest <= BALANCED) && ((polished != 0) || (largest <= 0.01 * BALANCED)))) {
            break;
        }
        polished = (largest <= BALANCED) ? 1 : 0;
        loads_by_twist(m);
        twists_by_load(m, by);
        complete(m, by);
        for (int j = 0; j < COORDINATES; j++) {
            step[j][0] = left[j / 6][j % 6];
        }
        twists_of(m, from);
        if (!factor(m->matrix[0], COORDINATES, SIDE, order)) {
            return NO_EQUILIBRIUM;
        }
        solve(m->matrix[0], COORDINATES, SIDE, order, step[0], WIDE);
        for (int j = 0; j < COORDINATES; j++) {
            most = fmax(most, fabs(step[j][0]));
        }
        share = fmin(1.0, 1.0 / fmax(most, 1e-300)); /* a turn must not come near pi */
        for (int half = 0; half < MOST_HALVINGS; half++) {
            for (int j = 0; j < COORDINATES; j++) {
                m->s.f[j / 6].twist[j % 6] = from[j / 6][j % 6] + share * step[j][0];
            }
            largest = residual(m, left);
            if ((largest < before) || (before < 10.0 * BALANCED)) {
                break;
            }
            share *= 0.5;
        }
    }
    return (largest <= BALANCED) ? FINE : NO_EQUILIBRIUM;
}

/* Return whether the energy has its least where the arm rests: with C the laws and G the change of minus the loads by the
 * twists, C + C G C is positive but for what does not give. For a law that is not symmetric this is enough, and more. */
static int least_energy(manipulator *m)
{
    double by[FLEXURES][6][6];
    loads_by_twist(m);
    twists_by_load(m, by);
    complete(m, by);
    for (int i = 0; i < COORDINATES; i++) {
        for (int k = 0; k < FLEXURES; k++) {
            double *row = m->matrix[i] + 6 * k, kept[6];
            memcpy(kept, row, sizeof kept);
            for (int b = 0; b < 6; b++) {
                row[b] = 0.0;
                for (int c = 0; c < 6; c++) {
                    row[b] += kept[c] * by[k][c][b];
                }
            }
        }
    }
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            int first = (a < 3) ? 0 : 3;
            double softest = fmax(fmax(by[k][first][first], by[k][first + 1][first + 1]), by[k][first + 2][first + 2]);
            m->matrix[6 * k + a][6 * k + a] += STIFF * fmax(softest, STIFF * STIFF);
        }
    }
    return positive(m->matrix[0], COORDINATES, SIDE, 0.0, m->matrix[0], SIDE);
}
#endif /* PROVEN */

/* Bring the arm to rest at joint positions, from the twists that are there. */
static int rest_at(manipulator *m, const double *from, const double *q)
{
    int code = NO_EQUILIBRIUM;
    (void)from;
    place_one(&m->table, &m->s, 1, q, 0);
    know_one(&m->table, &m->s, 1, q, 0);
#if !defined(PROVEN)
    {
        twists begin_at;
        twists_of(m, begin_at);
        code = draw(m, SLOW, PATIENCE);
        if (code != FINE) {
            set_twists(m, begin_at);
            code = newton(m);
        }
        if (code != FINE) { /* a law that is not smooth is no matter for Newton */
            set_twists(m, begin_at);
        }
    }
#endif /* PROVEN */
    if (code != FINE) {
        code = draw(m, RUNS_AWAY, 1);
    }
    for (int k = 0; (code == FINE) && (k < FLEXURES); k++) {
        const double *turn = &m->s.f[k].twist[3];
        if (!(dot_one(turn, turn) <= LARGEST_TURN * LARGEST_TURN)) {
            code = TOO_LARGE;
        }
    }
    return code;
}

/* Return the load on a flexure where it rests. */
static const double *load_at(const manipulator *m, whole flexure)
{
    return m->s.f[flexure].load;
}

/* Return whether the arm would stay where it rests: a small disturbance must shrink. It is turned by every probe to the
 * direction that shrinks least. Where the weight can never soften the arm so much, nothing need be tried. */
static int stays(manipulator *m)
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
#if !defined(PROVEN)
    if (!(ratio < 1.0) && (least_energy(m) != 0)) { /* it is stiffened by the load, and swings from probe to probe */
        ratio = 0.0;
    }
#endif /* PROVEN */
    return (ratio < 1.0) ? FINE : NO_EQUILIBRIUM;
}

/* Write where the tip of the rigid arm is. */
static int rigid_tip(manipulator *m, const double *q, double goal[3])
{
    place_one(&m->table, &m->s, 1, q, 0);
    memcpy(goal, m->s.tip, sizeof m->s.tip);
    return FINE;
}

/* Write the flexed tip's pose: its rotation is turned by a quaternion. */
static void flexed_tip(manipulator *m, double *pose)
{
    const double *u = m->s.quaternion, *own = m->table.elements + 20 * m->table.count;
    displace_one(&m->table, &m->s);
    for (int j = 0; j < 3; j++) {
        double axis[3], once[3], twice[3];
        for (int i = 0; i < 3; i++) {
            const double *turn = m->s.tip_turn + 3 * i;
            axis[i] = turn[0] * own[j] + turn[1] * own[3 + j] + turn[2] * own[6 + j];
        }
        cross_one(u + 1, axis, once);
        cross_one(u + 1, once, twice);
        for (int i = 0; i < 3; i++) {
            pose[4 * i + j] = axis[i] + 2.0 * (u[0] * once[i] + twice[i]);
        }
        pose[4 * j + 3] = m->s.tip[j] + m->s.pull[j];
    }
}

/* Write the change of the flexed tip [m] per joint about where the arm rests: it comes to rest again. `slope` holds the
 * change of the twists per joint from one time to the next, to begin near where that will be. */
static int derivatives(manipulator *m, const double *q, const double tip[3], derived slope, double jacobian[3][JOINTS])
{
    twists rest;
    double at[JOINTS], end[12];
    int code = FINE;
    twists_of(m, rest);
    memcpy(at, q, sizeof at);
    for (int j = 0; (j < JOINTS) && (code == FINE); j++) {
        at[j] = q[j] + DIFFERENCE;
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                m->s.f[k].twist[a] = rest[k][a] + DIFFERENCE * slope[j][k][a];
            }
        }
        code = rest_at(m, NULL, at);
        flexed_tip(m, end);
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                slope[j][k][a] = (m->s.f[k].twist[a] - rest[k][a]) / DIFFERENCE;
            }
        }
        at[j] = q[j];
        for (int i = 0; i < 3; i++) {
            jacobian[i][j] = (end[4 * i + 3] - tip[i]) / DIFFERENCE;
        }
    }
    set_twists(m, rest);
    return code;
}
