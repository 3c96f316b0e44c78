/*@head*/

#include <math.h>
#include <stddef.h>
#include <string.h>

/* ---- Interface ------------------------------------------------------------------------------------------------- */

extern const int NAME_nq;                       /* how many joints there are */
extern const char *const NAME_joints[];         /* their names, the order of q; NULL at the end */
extern const char *const NAME_payloads[];       /* names of the payloads, by their numbers; NULL at the end */
extern const char *const NAME_covariate_names[]; /* what the laws depend on beside q and the payload; NULL at the end */
extern double NAME_covariates[];                /* their values, SI and degrees Celsius: NaN until you set them */

int NAME_tip(const double *q, int payload, double *pose);
int NAME_compensate(const double *q, int payload, double *out);

enum {
    FINE = 0,
    NOT_FINITE = 1,     /* a joint position or a covariate is no number, or beyond 1000 rad or m */
    OUTSIDE_LIMITS = 2, /* a joint is beyond its limits */
    NO_PAYLOAD = 3,     /* there is no payload of this number */
    NO_EQUILIBRIUM = 4, /* the arm comes to rest nowhere near, or would not stay there */
    TOO_LARGE = 5,      /* a flexure turns by more than 0.1 rad, which no compliance describes */
    UNREACHED = 6       /* NAME_compensate alone: no joint positions near q and within the limits bring the tip there */
};

/* ---- Constants: SI units ---------------------------------------------------------------------------------------- */

/* An element of the chain from base to tip: its frame in the one before it is turned, where `rotated` is not 0, by
 * `rotation` and stands at `origin`; it turns about or slides along `axis` in its own frame with joint `number`, or
 * gives as flexure `number`, or is rigid. What is fixed to it has a mass and its centre in the element's frame. */
enum { RIGID, TURNS, SLIDES, FLEXES };
typedef struct {
    int kind, number, rotated;
    double rotation[3][3], origin[3], axis[3], mass, centre[3];
} element;

/* A payload: mass, centre in the tip's frame, and whether its weight is proven to be unable to make the arm buckle. */
typedef struct {
    double mass, centre[3];
    int proven;
} payload_body;
#if FACTORS

/* A function of one column: a joint's position, the payload's mass or a covariate, see know_laws; factor_at says how. */
enum { ONE, POWER, SINE, COSINE, STEP, BUMP, TENT, CREEP, OVERLAP, CHEBYSHEV, TABLE };
typedef struct {
    int kind, column;
    double a, b, c, d;
} factor;
#endif
#if CHANGING

/* A part of a flexure's law that is straight in the load, times two factors. */
typedef struct {
    int flexure, first, second;
    double offset[6], compliance[6][6];
} change;
#endif
#if TERMS

/* A part of a law that is not: what does not depend on the load and a matrix times the load, times features of the load
 * (numbers, see feature_at) and two factors; and the terms of one law, at loads drawn in to a window where one counts
 * (-1: none). The part u . w of a load counts, or a form. */
enum { PART, SIZE, CLIPPED, TANH, RAISED, RAMP };
#if FEATURES
typedef struct {
    int kind, form;
    double u[6], bias, exponent;
} feature;
#endif
typedef struct {
    int first, second, from, end, matrix;
    double along[6];
} term;
typedef struct {
    int flexure, window, first, end;
} group;
typedef struct {
    double offset[6], compliance[6][6];
} tangent; /* of a group: what stands for it near some load */
#endif
#if WINDOWS

/* The loads under which a correction was learned: an ellipsoid about a mean, and how the correction fades outside. */
typedef struct {
    double mean[6], precision[6][6], energy[6][6], faded;
} window;
#endif
#if PULLS

/* A force from outside on a point of an element, its place in the element's frame; `flexures` are inboard of it. */
enum { CONSTANT, SPRING, MAGNET };
typedef struct {
    int kind, element, flexures;
    double point[3], anchor[3], size, reach;
} pull;
#endif

/*@constants*/

/* How far the iterations go. All squares are sums over the flexures' shifts [m] and turns [rad]. */
enum { MOST_STEPS = 200, MOST_JUMPS = 20, MOST_AIMS = 15, WHOLE_AIMS = 5, PROBES = 100, FIRST_PROBES = 8 };
static const double AT_REST = 1e-24;         /* squared step, at most, of an equilibrium */
static const double NEXT_STEP = 4e-30;       /* squared step after it, were it to shrink as the last one did */
static const double RUNS_AWAY = 1e6;         /* by which a squared step may be longer than the one before */
static const double LARGEST_TURN = 0.1;      /* rad, of a flexure */
static const double LARGEST_POSITION = 1e3;  /* rad or m: beyond it is a mistake */
static const double ROUNDING = 1e-9;         /* rad or m: beyond a limit by less is no fault */
static const double LARGEST_CHANGE = 0.5;    /* rad or m, of a joint by NAME_compensate */
static const double REACHED = 1e-11;         /* m, of each coordinate of the tip */
static const double SETTLED = 1e-8;          /* rad or m, of the last change of the joints */
static const double DAMPING = 1e-14;         /* m^2, of the tip's Jacobian times its transpose */
static const double PROBE = 1e-6;            /* rad or m, by which an equilibrium is disturbed */
#if UNPROVEN
enum { COORDINATES = 6 * FLEXURES, MOST_NEWTON = 50, MOST_HALVINGS = 8, PATIENCE = 3 };
static const double SLOWEST = 0.5;           /* of a squared step by the one before it: Newton is quicker */
static const double BALANCED = 1e-12;        /* rad or m, of an equilibrium's residual */
static const double TWISTED_BY = 1e-6;       /* rad or m, for derivatives by the twists */
static const double STIFF = 1e-9;            /* part of the softest axis' compliance that a rigid one may have */
#endif
#if LOADED
static const double LOADED_BY = 1e-6;        /* part of a load, for derivatives by it */
#endif
static const double DIFFERENCE = 1e-7;       /* rad or m, for derivatives by the joints */

/* What is known of the arm at one configuration. Vectors are in base axes where nothing else is said. */
typedef double twists[FLEXURES][6];
typedef struct {
    double q[JOINTS];
    int payload;
    double tip_turn[3][3], tip[3]; /* frame of the rigid arm's tip */
    double turn[FLEXURES][3][3], origin[FLEXURES][3]; /* frame of each flexure in the rigid arm */
    double mass[FLEXURES];                            /* outboard of it [kg] */
    double moment[FLEXURES][3];       /* mass times place of what is between it and the next flexure [kg m] */
    twists twist;                     /* how it gives: shift [m] and rotation vector [rad], its own axes */
    twists load;                      /* force [N] and moment [Nm] on it, its own axes */
    double screw[FLEXURES][9];        /* see screw_of */
    twists offset;                    /* twist without load */
    double compliance[FLEXURES][6][6]; /* [m/N, rad/Nm and mixed] */
#if FACTORS
    double factor[FACTORS]; /* values of the factors */
#endif
#if TERMS
    const tangent *straight; /* what stands for the parts of laws that are not straight, NULL where they do themselves */
#endif
#if PULLS
    double point[PULLS][3]; /* where the pulled points of the rigid arm are [m] */
#endif
#if UNPROVEN
    double (*room)[6 * FLEXURES]; /* memory for a matrix of all coordinates */
#endif
} arm_state;

/* ---- Kinematics ------------------------------------------------------------------------------------------------- */

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static double dot6(const double *a, const double *b)
{
    return dot3(a, b) + dot3(&a[3], &b[3]);
}

static void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Add a vector in the axes of a frame to a point. */
static void shift(double point[3], double turn[3][3], const double *by, double times)
{
    for (int i = 0; i < 3; i++) {
        point[i] += times * (turn[i][0] * by[0] + turn[i][1] * by[1] + turn[i][2] * by[2]);
    }
}

/* Turn a frame by a constant rotation, or about one of its axes by an angle. */
static void rotate(double turn[3][3], const double rotation[3][3])
{
    for (int i = 0; i < 3; i++) {
        double x = turn[i][0], y = turn[i][1], z = turn[i][2];
        for (int j = 0; j < 3; j++) {
            turn[i][j] = x * rotation[0][j] + y * rotation[1][j] + z * rotation[2][j];
        }
    }
}

static void swing(double turn[3][3], const double *axis, double angle)
{
    double sine = sin(angle), half = sin(0.5 * angle), less = 2.0 * half * half; /* 1 - cos */
    for (int i = 0; i < 3; i++) {
        double once[3], twice[3];
        cross(turn[i], axis, once); /* a row of the frame turns the other way */
        cross(once, axis, twice);
        for (int j = 0; j < 3; j++) {
            turn[i][j] += sine * once[j] + less * twice[j];
        }
    }
}

/* Walk along a chain of elements at joint positions q to its tip. Where s is not NULL, note what the flexures need. */
static void walk(const element *elements, int count, const double *q, double turn[3][3], double tip[3], arm_state *s)
{
    int carrier = -1; /* the last flexure passed */
    for (int i = 0; i < 3; i++) {
        tip[i] = 0.0;
        for (int j = 0; j < 3; j++) {
            turn[i][j] = (i == j) ? 1.0 : 0.0;
        }
    }
    for (int k = 0; (s != NULL) && (k < FLEXURES); k++) {
        s->moment[k][0] = s->moment[k][1] = s->moment[k][2] = 0.0;
    }
    for (int k = 0; k < count; k++) {
        const element *here = &elements[k];
        shift(tip, turn, here->origin, 1.0);
        if (here->rotated != 0) {
            rotate(turn, here->rotation);
        }
        switch (here->kind) {
        case TURNS: swing(turn, here->axis, q[here->number]); break;
        case SLIDES: shift(tip, turn, here->axis, q[here->number]); break;
        case FLEXES: carrier = here->number; break;
        default: break;
        }
        if (s == NULL) {
            continue;
        }
        if (here->kind == FLEXES) {
            memcpy(s->origin[carrier], tip, sizeof s->origin[carrier]);
            memcpy(s->turn[carrier], turn, sizeof s->turn[carrier]);
        }
        if (carrier >= 0) {
            for (int i = 0; i < 3; i++) {
                s->moment[carrier][i] += here->mass * tip[i];
            }
            shift(s->moment[carrier], turn, here->centre, here->mass);
        }
#if PULLS
        for (int p = 0; p < PULLS; p++) {
            if (pulls[p].element == k) {
                memcpy(s->point[p], tip, sizeof s->point[p]);
                shift(s->point[p], turn, pulls[p].point, 1.0);
            }
        }
#endif
    }
    if ((s != NULL) && (carrier >= 0)) { /* the payload hangs on the tip, the last element */
        double mass = payloads[s->payload].mass;
        for (int i = 0; i < 3; i++) {
            s->moment[carrier][i] += mass * tip[i];
        }
        shift(s->moment[carrier], turn, payloads[s->payload].centre, mass);
        for (int k = 0; k < FLEXURES; k++) {
            s->mass[k] = outboard[k] + mass;
        }
    }
}

/* Write the screw by which flexure k moves all that is outboard of it: linear and angular part in base axes about the
 * base's origin, then the coefficients of w x u, w x (w x u) and w x p in its exponential, as series in the turn. */
static void screw_of(arm_state *s, int k)
{
    const double *twist = s->twist[k], *origin = s->origin[k];
    double *v = s->screw[k], *w = &s->screw[k][3], arm[3], square = dot3(&twist[3], &twist[3]);
    for (int i = 0; i < 3; i++) {
        v[i] = dot3(s->turn[k][i], twist);
        w[i] = dot3(s->turn[k][i], &twist[3]);
    }
    cross(w, origin, arm);
    for (int i = 0; i < 3; i++) {
        v[i] -= arm[i];
    }
    s->screw[k][6] = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0));
    s->screw[k][7] = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0));
    s->screw[k][8] = 1.0 - s->screw[k][7] * square;
}

/* Add to `to` how far a screw moves a body of a mass whose mass times place is `moment`; a point has a mass of 1. */
static void carry(const double *screw, double mass, const double *moment, double *to)
{
    double once[3], twice[3], thrice[3];
    cross(&screw[3], moment, once);
    for (int i = 0; i < 3; i++) {
        once[i] += mass * screw[i];
    }
    cross(&screw[3], once, twice);
    cross(&screw[3], twice, thrice);
    for (int i = 0; i < 3; i++) {
        to[i] += once[i] + screw[6] * twice[i] + screw[7] * thrice[i];
    }
}

/* Turn a vector by a screw, back (side = -1) or forth (side = 1). */
static void lean(const double *screw, double side, double *vector)
{
    double once[3], twice[3];
    cross(&screw[3], vector, once);
    cross(&screw[3], once, twice);
    for (int i = 0; i < 3; i++) {
        vector[i] += side * screw[8] * once[i] + screw[6] * twice[i];
    }
}

/* ---- Loads ------------------------------------------------------------------------------------------------------ */

/* Add a force, which acts at a point, to the load on flexure k. */
static void add_load(arm_state *s, int k, const double *force, const double *moment)
{
    for (int j = 0; j < 3; j++) {
        for (int i = 0; i < 3; i++) {
            s->load[k][j] += s->turn[k][i][j] * force[i];
            s->load[k][3 + j] += s->turn[k][i][j] * moment[i];
        }
    }
}
#if PULLS

/* Write the force [N] of a pull whose point has moved to `here`. */
static void pull_at(const pull *from, const double *here, double *force)
{
    double way[3], distance, size;
    for (int i = 0; i < 3; i++) {
        way[i] = from->anchor[i] - here[i];
    }
    distance = sqrt(dot3(way, way));
    switch (from->kind) {
    case SPRING: /* force per metre that it is longer than `reach`; slack pushes nothing */
        size = from->size * fmax(distance - from->reach, 0.0) / fmax(distance, 1e-9);
        break;
    case MAGNET: /* falls with the square of the distance, but for a reach */
        size = from->size / fmax(distance * distance + from->reach * from->reach, 1e-6) / fmax(distance, 1e-9);
        break;
    default: /* CONSTANT: the anchor is the force */
        memcpy(way, from->anchor, sizeof way);
        size = from->size;
        break;
    }
    for (int i = 0; i < 3; i++) {
        force[i] = size * way[i];
    }
}
#endif

/* Write the loads on the flexures, at their twists. What is outboard of a flexure is moved by the flexures outboard of
 * it; instead of turning it by those inboard, and by the flexure itself, gravity is turned back. */
static void weigh(arm_state *s)
{
    double moment[FLEXURES][3], down[3] = {gravity[0], gravity[1], gravity[2]};
    for (int k = FLEXURES - 1; k >= 0; k--) {
        screw_of(s, k);
        for (int i = 0; i < 3; i++) {
            moment[k][i] = s->moment[k][i];
            if (k < FLEXURES - 1) {
                moment[k][i] += moment[k + 1][i];
            }
        }
        if (k < FLEXURES - 1) {
            carry(s->screw[k + 1], s->mass[k + 1], moment[k + 1], moment[k]);
        }
    }
    for (int k = 0; k < FLEXURES; k++) {
        double lever[3], force[3], turning[3];
        lean(s->screw[k], -1.0, down);
        for (int i = 0; i < 3; i++) {
            lever[i] = moment[k][i] - s->mass[k] * s->origin[k][i];
            force[i] = s->mass[k] * down[i];
            s->load[k][i] = s->load[k][3 + i] = 0.0;
        }
        cross(lever, down, turning);
        add_load(s, k, force, turning);
    }
#if PULLS
    for (int p = 0; p < PULLS; p++) {
        double seen[FLEXURES][3], here[3] = {s->point[p][0], s->point[p][1], s->point[p][2]}, force[3];
        for (int k = pulls[p].flexures - 1; k >= 0; k--) {
            double to[3] = {here[0], here[1], here[2]};
            carry(s->screw[k], 1.0, here, to);
            for (int i = 0; i < 3; i++) {
                seen[k][i] = here[i] - s->origin[k][i];
                here[i] = to[i];
            }
        }
        pull_at(&pulls[p], here, force);
        for (int k = 0; k < pulls[p].flexures; k++) {
            double turning[3];
            lean(s->screw[k], -1.0, force);
            cross(seen[k], force, turning);
            add_load(s, k, force, turning);
        }
    }
#endif
}

/* ---- Laws ------------------------------------------------------------------------------------------------------- */
#if FACTORS
#if KNOTS

/* Return a cubic through values at knots 0, 1, ..., which closes or has the slopes of parabolas at its ends. */
static double table_at(const double *values, int count, int closes, double x)
{
    int k, last = closes ? count - 1 : count - 2;
    double t, before, left, right, after;
    if (!(fabs(x) < 1e15)) {
        return x - x; /* not a number */
    }
    t = closes ? x - count * floor(x / count) : fmin(fmax(x, 0.0), count - 1.0);
    k = ((int)t < last) ? (int)t : last;
    t -= k;
    left = values[k];
    right = values[(k + 1) % count];
    if (closes) {
        before = values[(k + count - 1) % count];
        after = values[(k + 2) % count];
    } else {
        double bent = (count > 2) ? 1.0 : 0.0;
        before = (k > 0) ? values[k - 1]
                         : (2.0 + bent) * left - (1.0 + 2.0 * bent) * right + bent * values[(k + 2) % count];
        after = (k < last) ? values[k + 2]
                           : (2.0 + bent) * right - (1.0 + 2.0 * bent) * left + bent * values[(k + count - 1) % count];
    }
    return left + 0.5 * t * (right - before + t * (2.0 * before - 5.0 * left + 4.0 * right - after
                                                   + t * (3.0 * (left - right) + after - before)));
}
#endif

/* Return the value of a factor where its column is x. */
static double factor_at(const factor *f, double x)
{
    double value = 1.0;
    switch (f->kind) {
    case POWER: /* ((x - a) / b)^c */
        for (int i = 0; i < (int)f->c; i++) {
            value *= (x - f->a) / f->b;
        }
        break;
    case SINE: value = sin(f->a * x); break;
    case COSINE: value = cos(f->a * x); break;
    case STEP: value = (x >= f->a) ? 1.0 : 0.0; break; /* from a on */
    case BUMP: value = exp(-0.5 * (x - f->a) / f->b * ((x - f->a) / f->b)); break;
    case TENT: /* 1 at knot d, 0 at the knots beside it; knots are c apart from a on, and b is the last */
        value = fmax(1.0 - fabs((fmin(fmax(x, f->a), f->b) - f->a) / f->c - f->d), 0.0);
        break;
    case CREEP: value = log1p(fmax(x, 0.0) / f->a); break;
    case OVERLAP: value = 1.0 / (f->a + fabs(x - f->b)); break;
    case CHEBYSHEV: { /* polynomial of degree c in a joint's travel, middle a, half b */
        double y = (x - f->a) / f->b, next = y;
        for (int i = 0; i < (int)f->c; i++) {
            double after = 2.0 * y * next - value;
            value = next;
            next = after;
        }
        break;
    }
#if KNOTS
    case TABLE: value = table_at(knots + (int)f->c, (int)fabs(f->d), f->d < 0.0, (x - f->a) / f->b); break;
#endif
    default: break; /* ONE */
    }
    return value;
}
#endif

/* Write what the laws are at the state's joint positions: the same under every load, and needed once. */
static void know_laws(arm_state *s)
{
    memcpy(s->offset, constant_offset, sizeof s->offset);
    memcpy(s->compliance, constant_compliance, sizeof s->compliance);
#if FACTORS
    for (int f = 0; f < FACTORS; f++) {
        int column = factors[f].column;
        double x = 0.0;
        if (column < JOINTS) {
            x = s->q[column];
        } else if (column == JOINTS) {
            x = payloads[s->payload].mass;
        } else {
            x = NAME_covariates[column - JOINTS - 1];
        }
        s->factor[f] = factor_at(&factors[f], x);
    }
#endif
#if CHANGING
    for (int c = 0; c < CHANGING; c++) {
        const change *law = &changing[c];
        double times = s->factor[law->first] * s->factor[law->second];
        for (int a = 0; a < 6; a++) {
            s->offset[law->flexure][a] += times * law->offset[a];
            for (int b = 0; b < 6; b++) {
                s->compliance[law->flexure][a][b] += times * law->compliance[a][b];
            }
        }
    }
#endif
}
#if FEATURES
#if FORMS

static double form_of(const double form[6][6], const double *w)
{
    double sum = 0.0;
    for (int a = 0; a < 6; a++) {
        sum += w[a] * dot6(form[a], w);
    }
    return sum;
}
#endif

/* Return the number that a feature makes of a load w. */
static double feature_at(const feature *f, const double *w)
{
    double value = dot6(f->u, w);
    switch (f->kind) {
    case SIZE: value = fabs(value); break;
    case RAMP: value = fmax(value + f->bias, 0.0); break; /* a stop on one side */
    case CLIPPED: value = fmin(fmax(value, -1.0), 1.0); break; /* play that the load takes up */
    case TANH: value = 1.0 - 2.0 / (exp(2.0 * (value + f->bias)) + 1.0); break; /* tanh takes twice as long */
#if FORMS
    case RAISED:
        value = fmax(f->bias + form_of(forms[f->form], w), 1e-300);
        if (f->exponent == 0.5) {
            value = sqrt(value);
        } else if (f->exponent == -0.5) {
            value = 1.0 / sqrt(value);
        } else if (f->exponent != 1.0) {
            value = pow(value, f->exponent);
        }
        break;
#endif
    default: break; /* PART */
    }
    return value;
}
#endif
#if WINDOWS

/* Draw a load in to those under which a correction was learned, and return how much of the correction counts: all
 * where the load is among those; beyond them the correction is carried on to twice as far, and fades. */
static double draw_in(const window *seen, double *w)
{
    double off[6], square = 0.0, reach = 0.0, weight = 1.0;
    for (int a = 0; a < 6; a++) {
        off[a] = w[a] - seen->mean[a];
    }
    for (int a = 0; a < 6; a++) {
        square += off[a] * dot6(seen->precision[a], off);
        reach += off[a] * dot6(seen->energy[a], off);
    }
    if (square > 1.0) {
        double distance = sqrt(square), share = (1.0 + tanh(distance - 1.0)) / distance;
        for (int a = 0; a < 6; a++) {
            w[a] = seen->mean[a] + share * off[a];
        }
        if (seen->faded > 1.0) { /* otherwise it never fades */
            double left = (seen->faded - sqrt(fmax(reach, 0.0))) / (seen->faded - 1.0);
            left = fmin(fmax(left, 0.0), 1.0);
            weight = left * left * left * (10.0 - 15.0 * left + 6.0 * left * left);
        }
    }
    return weight;
}
#endif

#if TERMS

/* Write what a part of a law that is not straight gives under a load. */
static void curve(const arm_state *s, const group *law, const double *load, double given[6])
{
    double w[6] = {load[0], load[1], load[2], load[3], load[4], load[5]}, weight = 1.0;
    double sum[6] = {0.0};
#if WINDOWS
    if (law->window >= 0) {
        weight = draw_in(&windows[law->window], w);
    }
#endif
    for (const term *t = &terms[law->first]; t < &terms[law->end]; t++) {
        double value = s->factor[t->first] * s->factor[t->second];
#if FEATURES
        for (int f = t->from; f < t->end; f++) {
            value *= feature_at(&features[f], w);
        }
#endif
        for (int a = 0; a < 6; a++) {
            sum[a] += value * t->along[a];
        }
#if FORMS
        for (int a = 0; (t->matrix >= 0) && (a < 6); a++) {
            sum[a] += value * dot6(forms[t->matrix][a], w);
        }
#endif
    }
    for (int a = 0; a < 6; a++) {
        given[a] = weight * sum[a];
    }
}

#if STRAIGHTENED
/* Write the tangents of such parts at the state's loads: near them they do for the parts. */
static void straighten(const arm_state *s, tangent *straight)
{
    for (int g = 0; g < CURVED; g++) {
        const double *w = s->load[curved[g].flexure];
        double given[6], least = 1.0;
        for (int b = 0; b < 6; b++) {
            least = fmax(least, fabs(w[b]));
        }
        curve(s, &curved[g], w, straight[g].offset);
        for (int b = 0; b < 6; b++) {
            double load[6] = {w[0], w[1], w[2], w[3], w[4], w[5]}, by = LOADED_BY * fmax(fabs(w[b]), 1e-3 * least);
            load[b] += by;
            curve(s, &curved[g], load, given);
            for (int a = 0; a < 6; a++) {
                straight[g].compliance[a][b] = (given[a] - straight[g].offset[a]) / by;
            }
        }
        for (int a = 0; a < 6; a++) {
            straight[g].offset[a] -= dot6(straight[g].compliance[a], w);
        }
    }
}
#endif
#endif

/* Write the twists that the laws give under the state's loads. */
static void deform(const arm_state *s, twists twist)
{
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            twist[k][a] = s->offset[k][a] + dot6(s->compliance[k][a], s->load[k]);
        }
    }
#if TERMS
    for (int g = 0; g < CURVED; g++) {
        int k = curved[g].flexure;
        double given[6];
        if (s->straight == NULL) {
            curve(s, &curved[g], s->load[k], given);
        }
        for (int a = 0; a < 6; a++) {
            if (s->straight != NULL) {
                given[a] = s->straight[g].offset[a] + dot6(s->straight[g].compliance[a], s->load[k]);
            }
            twist[k][a] += given[a];
        }
    }
#endif
}

/* ---- Equilibrium ------------------------------------------------------------------------------------------------ */

/* Put in `moved` the twists that the laws give under the loads at the state's twists; return the squared step. */
static double step_of(arm_state *s, twists moved)
{
    double square = 0.0;
    weigh(s);
    deform(s, moved);
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            double step = moved[k][a] - s->twist[k][a];
            square += step * step;
        }
    }
    return square;
}

/* Move the state's twists to rest: the fixed point of loads and laws, which stiff arms are drawn to in a few steps.
 * A squared step may, after some, be so many times as long as the one before it. */
static int draw(arm_state *s, double slowest, int patience)
{
    twists moved;
    double before = HUGE_VAL;
    int code = NO_EQUILIBRIUM;
    for (int step = 0; step < MOST_STEPS; step++) {
        double square = step_of(s, moved);
        memcpy(s->twist, moved, sizeof(twists));
        if ((step > 0) && (square <= AT_REST) && (square * square <= NEXT_STEP * before)) {
            code = FINE;
            break;
        }
        if (!(square < slowest * before) && (step >= patience)) { /* not a number is not less, either */
            break;
        }
        before = square;
    }
    return code;
}
#if UNPROVEN

/* Write the change of the loads per change of the twists about the state. */
static void loads_by_twist(arm_state *s)
{
    twists load;
    weigh(s);
    memcpy(load, s->load, sizeof(twists));
    for (int j = 0; j < COORDINATES; j++) {
        double kept = s->twist[j / 6][j % 6];
        s->twist[j / 6][j % 6] = kept + TWISTED_BY;
        weigh(s);
        s->twist[j / 6][j % 6] = kept;
        for (int i = 0; i < COORDINATES; i++) {
            s->room[i][j] = (s->load[i / 6][i % 6] - load[i / 6][i % 6]) / TWISTED_BY;
        }
    }
    weigh(s);
}

/* Write the change of every flexure's twist per change of its load: the tangents of the laws. */
static void twists_by_load(arm_state *s, double by[FLEXURES][6][6])
{
    twists here, there;
    deform(s, here);
    for (int b = 0; b < 6; b++) {
        double kept[FLEXURES], step[FLEXURES];
        for (int k = 0; k < FLEXURES; k++) {
            double least = 1.0;
            for (int a = 0; a < 6; a++) {
                least = fmax(least, fabs(s->load[k][a]));
            }
            kept[k] = s->load[k][b];
            step[k] = LOADED_BY * fmax(fabs(kept[k]), 1e-3 * least);
            s->load[k][b] += step[k];
        }
        deform(s, there);
        for (int k = 0; k < FLEXURES; k++) {
            s->load[k][b] = kept[k];
            for (int a = 0; a < 6; a++) {
                by[k][a][b] = (there[k][a] - here[k][a]) / step[k];
            }
        }
    }
}

/* Multiply the rows of every flexure in the matrix by minus a matrix of its own, and add the unit matrix. */
static void complete(arm_state *s, double by[FLEXURES][6][6])
{
    for (int k = 0; k < FLEXURES; k++) {
        for (int j = 0; j < COORDINATES; j++) {
            double column[6];
            for (int b = 0; b < 6; b++) {
                column[b] = s->room[6 * k + b][j];
            }
            for (int a = 0; a < 6; a++) {
                s->room[6 * k + a][j] = ((6 * k + a == j) ? 1.0 : 0.0) - dot6(by[k][a], column);
            }
        }
    }
}

/* Solve the linear system of the matrix, by Gauss with the largest pivots. */
static int solve(arm_state *s, double right[COORDINATES])
{
    for (int k = 0; k < COORDINATES; k++) {
        int best = k;
        double swap;
        for (int i = k + 1; i < COORDINATES; i++) {
            best = (fabs(s->room[i][k]) > fabs(s->room[best][k])) ? i : best;
        }
        if (!(fabs(s->room[best][k]) > 0.0)) {
            return NO_EQUILIBRIUM;
        }
        for (int j = k; j < COORDINATES; j++) {
            swap = s->room[k][j];
            s->room[k][j] = s->room[best][j];
            s->room[best][j] = swap;
        }
        swap = right[k];
        right[k] = right[best];
        right[best] = swap;
        for (int i = k + 1; i < COORDINATES; i++) {
            double times = s->room[i][k] / s->room[k][k];
            for (int j = k + 1; j < COORDINATES; j++) {
                s->room[i][j] -= times * s->room[k][j];
            }
            right[i] -= times * right[k];
        }
    }
    for (int k = COORDINATES - 1; k >= 0; k--) {
        for (int i = k + 1; i < COORDINATES; i++) {
            right[k] -= s->room[k][i] * right[i];
        }
        right[k] /= s->room[k][k];
    }
    return FINE;
}

/* Write how far the laws would move the twists; return the farthest of all, endless where it is no number. */
static double residual(arm_state *s, twists left)
{
    double largest = 0.0;
    (void)step_of(s, left);
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            left[k][a] -= s->twist[k][a];
            largest = (fabs(left[k][a]) < HUGE_VAL) ? fmax(largest, fabs(left[k][a])) : HUGE_VAL;
        }
    }
    return largest;
}

/* Move the twists to rest by Newton's method, whose steps are halved until the residual shrinks. */
static int newton(arm_state *s)
{
    twists left, from;
    double by[FLEXURES][6][6], step[COORDINATES], largest = residual(s, left);
    int polished = 0;
    for (int pass = 0; pass < MOST_NEWTON; pass++) {
        double factor = 1.0, before = largest, most = 0.0;
        if (!(largest < HUGE_VAL) || ((largest <= BALANCED) && ((polished != 0) || (largest <= 0.01 * BALANCED)))) {
            break;
        }
        polished = (largest <= BALANCED) ? 1 : 0;
        loads_by_twist(s);
        twists_by_load(s, by);
        complete(s, by);
        for (int j = 0; j < COORDINATES; j++) {
            step[j] = left[j / 6][j % 6];
        }
        memcpy(from, s->twist, sizeof(twists));
        if (solve(s, step) != FINE) {
            return NO_EQUILIBRIUM;
        }
        for (int j = 0; j < COORDINATES; j++) {
            most = fmax(most, fabs(step[j]));
        }
        factor = fmin(1.0, 1.0 / fmax(most, 1e-300)); /* a turn must not come near pi */
        for (int half = 0; half < MOST_HALVINGS; half++) {
            for (int j = 0; j < COORDINATES; j++) {
                s->twist[j / 6][j % 6] = from[j / 6][j % 6] + factor * step[j];
            }
            largest = residual(s, left);
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
static int least_energy(arm_state *s)
{
    double by[FLEXURES][6][6], root[6][COORDINATES]; /* the triangles of all flexures beside each other */
    loads_by_twist(s);
    twists_by_load(s, by);
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
                    sum += s->room[i][6 * k + c] * root[c][6 * k + b];
                }
                s->room[i][6 * k + b] = sum;
            }
        }
    }
    complete(s, by);
    for (int i = 0; i < COORDINATES; i++) {
        for (int j = 0; j < i; j++) {
            s->room[i][j] = 0.5 * (s->room[i][j] + s->room[j][i]);
        }
    }
    return factored(s->room, 0, COORDINATES);
}
#endif

/* Move the state's twists to rest. */
static int settle(arm_state *s)
{
#if UNPROVEN
    twists begin_at;
    int code;
    memcpy(begin_at, s->twist, sizeof(twists));
    code = draw(s, SLOWEST, PATIENCE);
    for (int trial = 0; (trial < 2) && (code != FINE); trial++) { /* a law that is not smooth is no matter for Newton */
        memcpy(s->twist, begin_at, sizeof(twists));
        code = (trial == 0) ? newton(s) : draw(s, RUNS_AWAY, 1);
    }
#else
    int code = draw(s, RUNS_AWAY, 1);
#endif
    for (int k = 0; (code == FINE) && (k < FLEXURES); k++) {
        if (!(dot3(&s->twist[k][3], &s->twist[k][3]) <= LARGEST_TURN * LARGEST_TURN)) {
            code = TOO_LARGE;
        }
    }
    return code;
}

/* Return whether the arm would stay where it rests: a small disturbance must shrink. It is turned by every probe to the
 * direction that shrinks least. Where the weight can never soften the arm so much, nothing need be tried. */
static int stays(arm_state *s)
{
    twists rest, off, moved;
    double ratio = 1.0;
    if (payloads[s->payload].proven != 0) {
        return FINE;
    }
    (void)step_of(s, rest);
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            s->twist[k][a] = rest[k][a];
            off[k][a] = PROBE * (1.0 + 0.1 * (double)((5 * k + 3 * a) % 7)) * (((k + a) % 2 == 0) ? 1.0 : -1.0);
        }
    }
    for (int probe = 0; probe < PROBES; probe++) {
        double square = 0.0, length;
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                s->twist[k][a] = rest[k][a] + off[k][a];
            }
        }
        weigh(s);
        deform(s, moved);
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                moved[k][a] -= rest[k][a];
                square += moved[k][a] * moved[k][a];
            }
        }
        length = sqrt(square);
        ratio = length / PROBE;
        if (!(length > 1e-9 * PROBE) || ((probe >= FIRST_PROBES) && (ratio < 0.5))) {
            break; /* it shrinks to nothing, or quickly */
        }
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                off[k][a] = moved[k][a] * (PROBE / length);
            }
        }
    }
    memcpy(s->twist, rest, sizeof(twists));
#if UNPROVEN
    if (!(ratio < 1.0) && (least_energy(s) != 0)) { /* it is stiffened by the load, and swings from probe to probe */
        ratio = 0.0;
    }
#endif
    return (ratio < 1.0) ? FINE : NO_EQUILIBRIUM;
}

/* Bring the arm to rest at the state's joint positions, from the state's twists. */
static int rest_at(arm_state *s)
{
    walk(chain, ELEMENTS, s->q, s->tip_turn, s->tip, s);
    know_laws(s);
    return settle(s);
}

/* Write where the flexed arm's tip is [m]. */
static void flexed_tip(arm_state *s, double tip[3])
{
    memcpy(tip, s->tip, sizeof s->tip);
    for (int k = FLEXURES - 1; k >= 0; k--) {
        double from[3] = {tip[0], tip[1], tip[2]};
        screw_of(s, k);
        carry(s->screw[k], 1.0, from, tip);
    }
}

/* Take over what is asked, or return what is wrong with it. */
static int begin(arm_state *s, const double *q, int payload)
{
    int code = FINE;
    if ((payload < 0) || (payload >= PAYLOADS)) {
        return NO_PAYLOAD;
    }
    s->payload = payload;
#if TERMS
    s->straight = NULL;
#endif
    for (int k = 0; k < FLEXURES; k++) {
        for (int a = 0; a < 6; a++) {
            s->twist[k][a] = 0.0;
        }
    }
    for (int j = 0; j < JOINTS; j++) {
        s->q[j] = q[j];
        if (!(fabs(q[j]) <= LARGEST_POSITION)) { /* not a number is not less, either */
            code = NOT_FINITE;
        } else if ((code == FINE) && ((q[j] < limits[j][0] - ROUNDING) || (q[j] > limits[j][1] + ROUNDING))) {
            code = OUTSIDE_LIMITS;
        }
    }
#if COVARIATES
    for (int c = 0; c < COVARIATES; c++) {
        if (!(fabs(NAME_covariates[c]) < HUGE_VAL)) {
            code = NOT_FINITE;
        }
    }
#endif
    return code;
}

/* ---- Tip -------------------------------------------------------------------------------------------------------- */

/* Write where the flexed arm's tip is at joint positions q under a payload.
 *
 * q: NAME_nq numbers [rad or m], in the order of NAME_joints. payload: its place in NAME_payloads.
 * pose: 12 numbers, rotation and origin [m] in the base frame as a 3 x 4 matrix row by row.
 * Returns 0, or one of the codes above; pose is then untouched. */
int NAME_tip(const double *q, int payload, double *pose)
{
    arm_state s;
#if UNPROVEN
    double room[COORDINATES][COORDINATES];
#endif
    int code = begin(&s, q, payload);
#if UNPROVEN
    s.room = room;
#endif
    if (code == FINE) {
        code = rest_at(&s);
    }
    if (code == FINE) {
        code = stays(&s);
    }
    if (code == FINE) {
        double tip[3];
        flexed_tip(&s, tip);
        for (int j = 0; j < 3; j++) {
            double axis[3] = {s.tip_turn[0][j], s.tip_turn[1][j], s.tip_turn[2][j]};
            for (int k = FLEXURES - 1; k >= 0; k--) {
                lean(s.screw[k], 1.0, axis);
            }
            for (int i = 0; i < 3; i++) {
                pose[4 * i + j] = axis[i];
            }
            pose[4 * j + 3] = tip[j];
        }
    }
    return code;
}

/* Write the change of the flexed tip [m] per joint about the state, whose tip is given: the arm comes to rest again.
 * `slope` holds the change of the twists per joint from one time to the next, to begin near where that will be. */
static int derivatives(const arm_state *s, const double tip[3], twists slope[JOINTS], double jacobian[3][JOINTS])
{
    arm_state off = *s;
    int code = FINE;
#if STRAIGHTENED
    tangent straight[CURVED];
    straighten(s, straight);
    off.straight = straight;
#endif
    for (int j = 0; (j < JOINTS) && (code == FINE); j++) {
        double end[3];
        off.q[j] = s->q[j] + DIFFERENCE;
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                off.twist[k][a] = s->twist[k][a] + DIFFERENCE * slope[j][k][a];
            }
        }
        code = rest_at(&off);
        flexed_tip(&off, end);
        for (int k = 0; k < FLEXURES; k++) {
            for (int a = 0; a < 6; a++) {
                slope[j][k][a] = (off.twist[k][a] - s->twist[k][a]) / DIFFERENCE;
            }
        }
        off.q[j] = s->q[j];
        for (int i = 0; i < 3; i++) {
            jacobian[i][j] = (end[i] - tip[i]) / DIFFERENCE;
        }
    }
    return code;
}

/*@smallest_change*/

/* ---- Compensation ----------------------------------------------------------------------------------------------- */

/* Write the joint positions nearest to q whose flexed tip is where the rigid arm's is at q, as the controller knows the
 * rigid arm; the orientation follows. Arguments as of NAME_tip; out: NAME_nq joint positions [rad or m], untouched
 * where a code is returned. `out` may be `q`. */
int NAME_compensate(const double *q, int payload, double *out)
{
    arm_state s;
    double goal[3], turn[3][3], tip[3], change[JOINTS] = {0.0}, low[JOINTS], high[JOINTS], jacobian[3][JOINTS];
    twists slope[JOINTS] = {{{0.0}}};
    double length = HUGE_VAL;
#if UNPROVEN
    double room[COORDINATES][COORDINATES];
#endif
    int code = begin(&s, q, payload);
#if UNPROVEN
    s.room = room;
#endif
    if (code != FINE) {
        return code;
    }
#if NOMINAL
    walk(nominal_chain, NOMINAL, q, turn, goal, NULL);
#else
    walk(chain, ELEMENTS, q, turn, goal, NULL);
#endif
    for (int jump = 0; jump <= MOST_JUMPS; jump++) {
        double wanted[3], aim[JOINTS] = {0.0}, from[JOINTS], left = 0.0, last = length;
        for (int j = 0; j < JOINTS; j++) {
            s.q[j] = q[j] + change[j];
        }
        code = rest_at(&s);
        if (code != FINE) {
            break;
        }
        flexed_tip(&s, tip);
        for (int i = 0; i < 3; i++) {
            left = fmax(left, fabs(goal[i] - tip[i]));
        }
        if ((left <= REACHED) && ((last <= SETTLED) || (jump > MOST_AIMS))) {
            break;
        }
        code = (jump < MOST_JUMPS) ? derivatives(&s, tip, slope, jacobian) : UNREACHED;
        if (code != FINE) {
            break;
        }
        /* The smallest change in all that does it to first order; or, where these go round in circles, further. */
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
        smallest_change(jacobian, wanted, low, high, aim);
        length = 0.0;
        for (int j = 0; j < JOINTS; j++) {
            length = fmax(length, fabs(from[j] + aim[j] - change[j]));
            change[j] = from[j] + aim[j];
        }
    }
    if (code == FINE) {
        code = stays(&s);
    }
    if (code == FINE) {
        memcpy(out, s.q, sizeof s.q);
    }
    return code;
}
