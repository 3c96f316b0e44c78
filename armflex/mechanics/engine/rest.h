/* Where a chain rests, for one row or for several at once: included for each with another `real`. */

typedef struct {
    real turn[9], origin[3]; /* in the rigid arm */
    real moment[3];          /* first moment about the base of what is between it and the next */
    real screw[6], second, third, first; /* its twist in base axes, and the coefficients of its exponential */
    real lever[3], seen[3];              /* of all that is outboard, and of a load, about its origin */
    real load[6], twist[6], next[6];
#if !defined(CONTROLLER)
    real told[6], gave[6]; /* its neurons, when they were asked */
#endif /* CONTROLLER */
    int apart; /* whether its law is a compliance without coupling, and an offset */
} T(flexure);
typedef struct {
    real compliance[36], offset[6];
} T(law);
typedef struct { /* of an element in the rigid arm: its joint's screw about the base, and its body */
    real screw[6], centre[3], inertia[6];
} T(body);
typedef struct {
    T(flexure) *f;
    T(law) *law;
    T(body) *body; /* of an arm that moves */
    real *rates, *inertial;
    real *weights, *factor, *points, *pushes;
#if !defined(CONTROLLER)
    neural *hidden; /* of each neuron what it is told and says */
#endif /* CONTROLLER */
    real tip[3], tip_turn[9], pull[3], quaternion[4];
} T(state);

static inline real T(dot)(const real *a, const real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline real T(squares)(const real *twist)
{
    return T(dot)(twist, twist) + T(dot)(twist + 3, twist + 3);
}

/* Element by element: memcpy of an array would keep it out of registers. */
static inline void T(copy)(real *to, const real *from, int count)
{
    for (int i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

static inline void T(cross)(const real *a, const real *b, real *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static inline void T(shift)(real *to, const real *turn, const double *by, double times)
{
    for (int i = 0; i < 3; i++) {
        to[i] += turn[3 * i] * (times * by[0]) + turn[3 * i + 1] * (times * by[1]) + turn[3 * i + 2] * (times * by[2]);
    }
}

/* Fill the twist of a flexure in base axes, and the coefficients of its exponential. */
static inline void T(screw_of)(T(flexure) *f)
{
    real s = T(dot)(f->twist + 3, f->twist + 3), third;
    for (int i = 0; i < 3; i++) {
        f->screw[i] = T(dot)(f->turn + 3 * i, f->twist);
        f->screw[3 + i] = T(dot)(f->turn + 3 * i, f->twist + 3);
    }
    third = 1.0 / 6 - s * (1.0 / 120 - s * (1.0 / 5040 - s * (1.0 / 362880)));
    f->second = 0.5 - s * (1.0 / 24 - s * (1.0 / 720 - s * (1.0 / 40320)));
    f->third = third;
    f->first = 1.0 - third * s;
}

/* Add how far a flexure moves what has a mass and a first moment about its origin; a point has a mass of 1. */
static inline void T(carry)(const T(flexure) *f, double mass, const real *lever, real *to)
{
    real once[3], twice[3], thrice[3];
    T(cross)(f->screw + 3, lever, once);
    for (int i = 0; i < 3; i++) {
        once[i] += mass * f->screw[i];
    }
    T(cross)(f->screw + 3, once, twice);
    T(cross)(f->screw + 3, twice, thrice);
    for (int i = 0; i < 3; i++) {
        to[i] += once[i] + f->second * twice[i] + f->third * thrice[i];
    }
}

/* Turn a vector as a flexure does, back (-1) or forth (1). */
static inline void T(lean)(const T(flexure) *f, double side, real *vector)
{
    real once[3], twice[3];
    T(cross)(f->screw + 3, vector, once);
    T(cross)(f->screw + 3, once, twice);
    for (int i = 0; i < 3; i++) {
        vector[i] += side * f->first * once[i] + f->second * twice[i];
    }
}

/* Turn a frame about an axis of its own: sine and versine by the series of a quarter of the angle, doubled twice. */
static inline void T(swing)(real *turn, const double *axis, real angle)
{
    real turns = T(nearest)(angle * TURNS_PER_RADIAN), x = 0.25 * ((angle - turns * TURN) - turns * TURN_REST);
    real y = x * x, sine, cosine, less;
    sine = 1.0 / 362880 - y * (1.0 / 39916800 - y * (1.0 / 6227020800.0 - y * (1.0 / 1307674368000.0 - y * (1.0 / 355687428096000.0))));
    sine = x * (1.0 - y * (1.0 / 6 - y * (1.0 / 120 - y * (1.0 / 5040 - y * sine))));
    cosine = 1.0 / 3628800 - y * (1.0 / 479001600 - y * (1.0 / 87178291200.0 - y * (1.0 / 20922789888000.0)));
    cosine = 1.0 - y * (0.5 - y * (1.0 / 24 - y * (1.0 / 720 - y * (1.0 / 40320 - y * cosine))));
    less = 2.0 * sine * sine;
    sine = 2.0 * sine * cosine;
    cosine = 1.0 - less;
    less = 2.0 * sine * sine;
    sine = 2.0 * sine * cosine;
    for (int j = 0; j < 3; j++) {
        if ((axis[j] * axis[j] == 1.0) && (axis[(j + 1) % 3] == 0.0) && (axis[(j + 2) % 3] == 0.0)) {
            real *next = turn + (j + 1) % 3, *last = turn + (j + 2) % 3;
            sine *= axis[j];
            for (int i = 0; i < 9; i += 3) {
                real x = next[i], y = last[i];
                next[i] = x + (sine * y - less * x);
                last[i] = y - (sine * x + less * y);
            }
            return;
        }
    }
    for (int i = 0; i < 3; i++) {
        real *row = turn + 3 * i, once[3], twice[3];
        once[0] = row[1] * axis[2] - row[2] * axis[1];
        once[1] = row[2] * axis[0] - row[0] * axis[2];
        once[2] = row[0] * axis[1] - row[1] * axis[0];
        twice[0] = once[1] * axis[2] - once[2] * axis[1];
        twice[1] = once[2] * axis[0] - once[0] * axis[2];
        twice[2] = once[0] * axis[1] - once[1] * axis[0];
        for (int j = 0; j < 3; j++) {
            row[j] += sine * once[j] + less * twice[j];
        }
    }
}

#if !defined(CONTROLLER)
/* Keep an element's joint and body where the rigid arm has them, for an arm that moves. */
static void T(keep)(const arm *a, T(state) *s, whole k, const real *turn, const real *tip, whole rows, whole first)
{
    const double *local = a->elements + 20 * k, *own = a->inertias + 6 * k;
    const double about[9] = {own[0], own[3], own[4], own[3], own[1], own[5], own[4], own[5], own[2]};
    whole kind = a->kinds[k] & 3, joint = a->kinds[a->count + k];
    T(body) *body = s->body + k;
    real half[9], about_base[9], axis[3] = {T(all)(0.0), T(all)(0.0), T(all)(0.0)};
    T(copy)(body->centre, tip, 3);
    T(shift)(body->centre, turn, local + 16, 1.0);
    T(shift)(axis, turn, local + 12, 1.0);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            half[3 * i + j] = turn[3 * i] * about[j] + turn[3 * i + 1] * about[3 + j] + turn[3 * i + 2] * about[6 + j];
        }
        for (int j = 0; j < 3; j++) {
            about_base[3 * i + j] = T(dot)(half + 3 * i, turn + 3 * j);
        }
        body->inertia[i] = about_base[4 * i];
    }
    body->inertia[3] = about_base[3];
    body->inertia[4] = about_base[6];
    body->inertia[5] = about_base[7];
    for (int i = 0; i < 6; i++) {
        body->screw[i] = T(all)(0.0);
    }
    if ((kind == TURNS) || (kind == SLIDES)) {
        memcpy(body->screw + ((kind == TURNS) ? 3 : 0), axis, sizeof axis);
        if (kind == TURNS) {
            T(cross)(tip, axis, body->screw);
        }
        for (int c = 0; c < LANES; c++) {
            const double *rates = a->motion + 2 * a->driven * ((first + c < rows) ? first + c : rows - 1);
            AT(s->rates[2 * k], c) = rates[joint];
            AT(s->rates[2 * k + 1], c) = rates[a->driven + joint];
        }
    }
}
#endif /* CONTROLLER */

/* Place the rigid arm. */
static void T(place)(const arm *a, T(state) *s, whole rows, const double *q, whole first)
{
    real turn[9], tip[3];
    whole carrier = -1;
    for (int i = 0; i < 9; i++) {
        turn[i] = T(all)((i % 4 == 0) ? 1.0 : 0.0);
    }
    tip[0] = tip[1] = tip[2] = T(all)(0.0);
    for (whole i = 0; i < a->flexures; i++) {
        s->f[i].moment[0] = s->f[i].moment[1] = s->f[i].moment[2] = T(all)(0.0);
    }
    for (whole k = 1; k <= a->count; k++) {
        const double *local = a->elements + 20 * k;
        whole kind = (k < a->count) ? a->kinds[k] : RIGID, own = (k < a->count) ? a->kinds[a->count + k] : -1;
        if ((local[9] != 0.0) || (local[10] != 0.0) || (local[11] != 0.0)) {
            T(shift)(tip, turn, local + 9, 1.0);
        }
        if (k == a->count) { /* the tip's own rotation is left out */
            T(copy)(s->tip_turn, turn, 9);
            T(copy)(s->tip, tip, 3);
            break;
        }
        if ((kind & ROTATED) != 0) {
            for (int i = 0; i < 3; i++) {
                real x = turn[3 * i], y = turn[3 * i + 1], z = turn[3 * i + 2];
                for (int j = 0; j < 3; j++) {
                    turn[3 * i + j] = x * local[j] + y * local[3 + j] + z * local[6 + j];
                }
            }
        }
        kind &= 3;
        if (kind == FLEXURE) {
            carrier = own;
            T(copy)(s->f[own].origin, tip, 3);
            T(copy)(s->f[own].turn, turn, 9);
        } else if (kind != RIGID) {
            real value = T(all)(0.0);
            for (int c = 0; c < LANES; c++) {
                whole r = (first + c < rows) ? first + c : rows - 1;
                AT(value, c) = q[r * a->driven + own];
            }
            if (kind == TURNS) {
                T(swing)(turn, local + 12, value);
            } else {
                for (int i = 0; i < 3; i++) {
                    tip[i] += value * (turn[3 * i] * local[12] + turn[3 * i + 1] * local[13] + turn[3 * i + 2] * local[14]);
                }
            }
        }
        if ((carrier >= 0) && (local[15] > 0.0)) {
            for (int i = 0; i < 3; i++) {
                s->f[carrier].moment[i] += local[15] * tip[i];
            }
            T(shift)(s->f[carrier].moment, turn, local + 16, local[15]);
        }
#if !defined(CONTROLLER)
        if (a->motion != NULL) {
            T(keep)(a, s, k, turn, tip, rows, first);
        }
#endif /* CONTROLLER */
        for (whole j = 0; j < a->pushes; j++) {
            if (a->links[3 * j] == k) {
                real *point = s->points + 3 * j, *push = s->pushes + 6 * j, own_axes[6] = {T(all)(0.0)};
                T(copy)(point, tip, 3);
                T(shift)(point, turn, a->wrenches + 9 * j, 1.0);
                for (int i = 0; i < 6; i++) {
                    for (int c = 0; c < LANES; c++) {
                        whole r = (first + c < a->wrench_rows) ? first + c : a->wrench_rows - 1;
                        AT(own_axes[i], c) = a->wrenches[9 * (r * a->pushes + j) + 3 + i];
                    }
                }
                for (int i = 0; i < 6; i++) {
                    push[i] = (a->links[3 * j + 2] != 0) ? T(dot)(turn + 3 * (i % 3), own_axes + i / 3 * 3) : own_axes[i];
                }
            }
        }
    }
}

static inline void T(add_load)(T(flexure) *f, const real *force, const real *moment)
{
    for (int j = 0; j < 3; j++) {
        f->load[j] += f->turn[j] * force[0] + f->turn[3 + j] * force[1] + f->turn[6 + j] * force[2];
        f->load[3 + j] += f->turn[j] * moment[0] + f->turn[3 + j] * moment[1] + f->turn[6 + j] * moment[2];
    }
}

static inline void T(bear)(T(flexure) *f, const real *wrench)
{
    real moment[3];
    T(cross)(f->seen, wrench, moment);
    for (int i = 0; i < 3; i++) {
        moment[i] += wrench[3 + i];
    }
    T(add_load)(f, wrench, moment);
}

#if !defined(CONTROLLER)
/* Fill where the base's origin is as a flexure sees it, and how far it would move it. */
static void T(see_origin)(T(flexure) *f, int flexed, real *moved)
{
    for (int i = 0; i < 3; i++) {
        f->seen[i] = -f->origin[i];
        moved[i] = T(all)(0.0);
    }
    if (flexed) {
        T(carry)(f, 1.0, f->seen, moved);
    }
}

/* Take a twist about the base's origin from inboard of a flexure to outboard of it. */
static void T(twist_out)(const T(flexure) *f, const real *moved, real *linear, real *angular)
{
    real lever[3];
    T(cross)(moved, angular, lever);
    for (int i = 0; i < 3; i++) {
        linear[i] -= lever[i];
    }
    T(lean)(f, -1.0, linear);
    T(lean)(f, -1.0, angular);
}

/* Take a wrench about the base's origin from outboard of a flexure to inboard of it. */
static void T(wrench_in)(const T(flexure) *f, const real *moved, real *wrench)
{
    real lever[3];
    T(lean)(f, 1.0, wrench);
    T(lean)(f, 1.0, wrench + 3);
    T(cross)(moved, wrench, lever);
    for (int i = 0; i < 3; i++) {
        wrench[3 + i] += lever[i];
    }
}

/* Add what bodies need to be accelerated to the loads on the flexures, which do not move themselves: out along the
 * arm with speeds and accelerations, back with wrenches, all about the base's origin as it is in the rigid arm. */
static void T(accelerate)(const arm *a, T(state) *s, int flexed)
{
    const whole *order = a->kinds + 2 * a->count;
    real v[3], w[3], p[3], o[3], wrench[6], moved[3];
    whole carrier = -1, n = a->flexures;
    for (int i = 0; i < 3; i++) {
        v[i] = w[i] = p[i] = o[i] = T(all)(0.0); /* p and o change v and w */
        wrench[i] = wrench[3 + i] = T(all)(0.0);
    }
    for (whole i = 0; i < 6 * n; i++) {
        s->inertial[i] = T(all)(0.0);
    }
    for (whole k = 1; k < a->count; k++) {
        const T(body) *body = s->body + k;
        const real *u = body->screw, *rates = s->rates + 2 * k, *about = body->inertia, *c = body->centre;
        whole kind = a->kinds[k] & 3;
        if (kind == FLEXURE) {
            carrier = a->kinds[a->count + k];
            if (flexed) {
                T(see_origin)(s->f + carrier, 1, moved);
                T(twist_out)(s->f + carrier, moved, v, w);
                T(twist_out)(s->f + carrier, moved, p, o);
            }
        } else if (kind != RIGID) {
            real one[3], two[3], three[3];
            T(cross)(w, u, one);
            T(cross)(v, u + 3, two);
            T(cross)(w, u + 3, three);
            for (int i = 0; i < 3; i++) {
                p[i] += rates[1] * u[i] + rates[0] * (one[i] + two[i]);
                o[i] += rates[1] * u[3 + i] + rates[0] * three[i];
                v[i] += rates[0] * u[i];
                w[i] += rates[0] * u[3 + i];
            }
        }
        if (carrier >= 0) {
            double mass = a->elements[20 * k + 15];
            real speed[3], force[3], turning[3], spin[3], moment[3], twice[3], *into = s->inertial + 6 * carrier;
            T(cross)(w, c, speed);
            for (int i = 0; i < 3; i++) {
                speed[i] += v[i];
            }
            T(cross)(w, speed, force);
            T(cross)(o, c, turning);
            spin[0] = about[0] * w[0] + about[3] * w[1] + about[4] * w[2];
            spin[1] = about[3] * w[0] + about[1] * w[1] + about[5] * w[2];
            spin[2] = about[4] * w[0] + about[5] * w[1] + about[2] * w[2];
            T(cross)(w, spin, moment);
            moment[0] += about[0] * o[0] + about[3] * o[1] + about[4] * o[2];
            moment[1] += about[3] * o[0] + about[1] * o[1] + about[5] * o[2];
            moment[2] += about[4] * o[0] + about[5] * o[1] + about[2] * o[2];
            for (int i = 0; i < 3; i++) {
                force[i] = mass * (force[i] + turning[i] + p[i]);
            }
            T(cross)(c, force, twice);
            for (int i = 0; i < 3; i++) {
                into[i] -= force[i];
                into[3 + i] -= moment[i] + twice[i];
            }
        }
    }
    for (whole step = n - 1; step >= 0; step--) {
        T(flexure) *f = s->f + order[step];
        for (int i = 0; i < 6; i++) {
            wrench[i] += s->inertial[6 * order[step] + i];
        }
        T(see_origin)(f, flexed, moved);
        T(bear)(f, wrench);
        if (flexed) {
            T(wrench_in)(f, moved, wrench);
        }
    }
}
#endif /* CONTROLLER */

/* Add loads of wrenches; those that are dead are turned back instead of turning the arm. */
static void T(push)(const arm *a, T(state) *s, int flexed)
{
    const whole *order = a->kinds + 2 * a->count;
    for (whole j = 0; j < a->pushes; j++) {
        whole outmost = a->links[3 * j + 1] - 1;
        int follows = a->links[3 * j + 2] != 0, pulled = (a->pulls != NULL) && (a->pulls[6 * j] > 0.0);
        real wrench[6] = {T(all)(0.0)}, here[3] = {s->points[3 * j], s->points[3 * j + 1], s->points[3 * j + 2]};
        T(copy)(wrench, s->pushes + 6 * j, 6);
        for (whole step = outmost; step >= 0; step--) {
            T(flexure) *f = s->f + order[step];
            for (int i = 0; i < 3; i++) {
                f->seen[i] = here[i] - f->origin[i];
            }
            if (follows) {
                T(bear)(f, wrench);
            }
            if (((step > 0) || pulled) && flexed) {
                T(carry)(f, 1.0, f->seen, here);
                if (follows) {
                    T(lean)(f, 1.0, wrench);
                    T(lean)(f, 1.0, wrench + 3);
                }
            }
        }
        for (int c = 0; (c < LANES) && pulled; c++) {
            double at[3] = {AT(here[0], c), AT(here[1], c), AT(here[2], c)}, force[3];
            pull_at(a->pulls + 6 * j, at, force);
            for (int i = 0; i < 3; i++) {
                AT(wrench[i], c) = force[i];
                AT(wrench[3 + i], c) = 0.0;
            }
        }
        for (whole step = 0; (step <= outmost) && !follows; step++) {
            T(flexure) *f = s->f + order[step];
            if (flexed) {
                T(lean)(f, -1.0, wrench);
                T(lean)(f, -1.0, wrench + 3);
            }
            T(bear)(f, wrench);
        }
    }
}

/* Fill what the laws are in some rows: factors of columns, and what is affine in the load. */
static void T(know)(const arm *a, T(state) *s, whole rows, const double *q, whole first)
{
    for (whole f = 0; f < a->factors; f++) {
        const double *one = a->factor + 6 * f;
        whole column = (whole)one[1];
        for (int c = 0; c < LANES; c++) {
            whole r = (first + c < rows) ? first + c : rows - 1;
            double x = (column < a->driven) ? q[r * a->driven + column] : a->known[column - a->driven];
            AT(s->factor[f], c) = factor_at(one, a->knots, x);
        }
    }
    for (whole t = 0; t < a->terms; t++) {
        for (int c = 0; c < LANES; c++) {
            whole r = (first + c < a->weight_rows) ? first + c : a->weight_rows - 1;
            AT(s->weights[t], c) = a->weights[r * a->terms + t];
        }
        if (a->factors > 0) {
            s->weights[t] *= s->factor[a->weighing[2 * t]] * s->factor[a->weighing[2 * t + 1]];
        }
    }
    for (whole i = 0; i < a->flexures; i++) {
        for (int b = 0; (b < 42) && ((a->varies[i] != 0) || (a->law_rows > 1)); b++) {
            real *to = (b < 36) ? s->law[i].compliance + b : s->law[i].offset + b - 36;
            for (int c = 0; c < LANES; c++) {
                whole r = (first + c < a->law_rows) ? first + c : a->law_rows - 1;
                AT(*to, c) = (b < 36) ? a->compliance[(r * a->flexures + i) * 36 + b] : a->offset[(r * a->flexures + i) * 6 + b - 36];
            }
        }
    }
    for (whole t = 0; t < a->changing; t++) {
        const double *one = a->change + 45 * t;
        T(law) *law = s->law + (whole)one[0];
        real times = s->factor[(whole)one[1]] * s->factor[(whole)one[2]];
        for (int b = 0; b < 6; b++) {
            law->offset[b] += times * one[3 + b];
        }
        for (int b = 0; b < 36; b++) {
            law->compliance[b] += times * one[9 + b];
        }
    }
}

#if !defined(CONTROLLER)
/* Add what the neurons of a flexure give where each is told nearly what it was told when it was asked, by the tangent and
 * the two terms after it, whose rest is the change to the fourth; return whether that is so. */
static inline int T(lean_on)(const arm *a, const T(flexure) *f, const neural *own, whole i, real *twist)
{
    const double *first = a->neurons + 52 * a->starts[i], *last = a->neurons + 52 * a->starts[i + 1];
    neural by[6], sum[6], none = given(T(all)(0.0)), furthest = none;
    for (int b = 0; b < 6; b++) {
        by[b] = given(f->load[b] - f->told[b]);
        sum[b] = none;
    }
    for (const double *u = first; u < last; u += 52) {
        for (int j = 0; j < WIDE; j += EACH) {
            neural change = weight(u + j) * by[0], rest = weight(u + 12 + j) * by[3], said = own[1], slope, bend;
            for (int b = 1; b < 3; b++) { /* two sums, which do not wait for each other */
                change += weight(u + 4 * b + j) * by[b];
                rest += weight(u + 12 + 4 * b + j) * by[3 + b];
            }
            change += rest;
            slope = 1.0 - said * said;
            bend = change * (2.0 / 3 - slope) - said;
            bend = change * bend + 1.0;
            furthest += change * change;
            change *= slope;
            change *= bend;
            own += 2;
            for (int b = 0; b < 6; b++) {
                sum[b] += weight(u + 28 + 4 * b + j) * change;
            }
        }
    }
    for (int b = 0; b < 6; b++) {
        twist[b] += f->gave[b] + gathered(sum[b]);
    }
    return !N(exceeds)(furthest, CLOSE * CLOSE);
}

/* The same where each is told not much else: with t = tanh x and s = tanh d, tanh (x + d) = t + s (1 - t^2) / (1 + s t). */
static inline int T(move_on)(const arm *a, const T(flexure) *f, neural *own, whole i, neural *sum)
{
    const double *first = a->neurons + 52 * a->starts[i], *last = a->neurons + 52 * a->starts[i + 1];
    neural at[6], none = given(T(all)(0.0)), furthest = none;
    for (int b = 0; b < 6; b++) {
        at[b] = given(f->load[b]);
        sum[b] = none;
    }
    for (const double *u = first; u < last; u += 52) {
        for (int j = 0; j < WIDE; j += EACH) {
            neural told = weight(u + 24 + j), rest = weight(u + 12 + j) * at[3], said = own[1], by, square, turn, twice;
            for (int b = 0; b < 3; b++) {
                told += weight(u + 4 * b + j) * at[b];
            }
            for (int b = 4; b < 6; b++) {
                rest += weight(u + 4 * b + j) * at[b];
            }
            told += rest;
            by = told - own[0];
            square = by * by;
            furthest += square * square;
            by -= by * square * (1.0 / 3 - square * (2.0 / 15 - square * (17.0 / 315)));
            turn = by * said;
            twice = turn * turn;
            by = (by - turn * said) * (1.0 - turn);
            said += (by + by * twice) * (1.0 + twice * twice);
            own[0] = told;
            own[1] = said;
            own += 2;
            for (int b = 0; b < 6; b++) {
                sum[b] += weight(u + 28 + 4 * b + j) * said;
            }
        }
    }
    return !N(exceeds)(furthest, NEAR * NEAR * NEAR * NEAR);
}
#endif /* CONTROLLER */

/* Add what the neurons of a flexure give under its load in a pass of so high a number. */
static void T(fire)(const arm *a, T(state) *s, whole i, int pass, real *twist)
{
    const double *first = a->neurons + 52 * a->starts[i], *last = a->neurons + 52 * a->starts[i + 1];
    T(flexure) *f = s->f + i;
    neural at[6], sum[6];
    int anew = 1;
#if !defined(CONTROLLER)
    neural *own = s->hidden + 2 * WIDE / EACH * a->starts[i];
    real given_[6];
    T(copy)(given_, twist, 6);
    if ((pass > 1) && T(lean_on)(a, f, own, i, given_)) {
        T(copy)(twist, given_, 6);
        return;
    }
    anew = (pass == 0) || !T(move_on)(a, f, own, i, sum);
#endif /* CONTROLLER */
    (void)pass;
    for (int b = 0; (b < 6) && anew; b++) {
        at[b] = given(f->load[b]);
        sum[b] = given(T(all)(0.0));
    }
    for (const double *u = first; (u < last) && anew; u += 52) {
        for (int j = 0; j < WIDE; j += EACH) {
            neural told = weight(u + 24 + j), said;
            for (int b = 0; b < 6; b++) {
                told += weight(u + 4 * b + j) * at[b];
            }
            said = N(bounded)(told);
#if !defined(CONTROLLER)
            own[0] = told;
            own[1] = said;
            own += 2;
#endif /* CONTROLLER */
            for (int b = 0; b < 6; b++) {
                sum[b] += weight(u + 28 + 4 * b + j) * said;
            }
        }
    }
    for (int b = 0; b < 6; b++) {
        real gave = gathered(sum[b]);
        twist[b] += gave;
#if !defined(CONTROLLER)
        f->told[b] = f->load[b];
        f->gave[b] = gave;
#endif /* CONTROLLER */
    }
}

/* Fill in `next` the twists that laws give under the loads, but where these were a compliance without coupling. */
static void T(deform)(const arm *a, T(state) *s, int pass)
{
    for (whole i = 0; i < a->flexures; i++) {
        if (s->f[i].apart) {
            continue;
        }
        real borne[6], twist[6], drawn[6], counts = T(all)(1.0);
        const real *load = borne;
        whole window = -1;
        T(copy)(borne, s->f[i].load, 6);
        if ((a->varies[i] != 0) || (a->law_rows > 1)) {
            const T(law) *law = s->law + i;
            for (int b = 0; b < 6; b++) {
                const real *c = law->compliance + 6 * b;
                twist[b] = law->offset[b] + c[0] * load[0] + c[1] * load[1] + c[2] * load[2] + c[3] * load[3] + c[4] * load[4] + c[5] * load[5];
            }
        } else {
            for (int b = 0; b < 6; b++) {
                const double *c = a->compliance + 36 * i + 6 * b;
                twist[b] = a->offset[6 * i + b] + c[0] * load[0] + c[1] * load[1] + c[2] * load[2] + c[3] * load[3] + c[4] * load[4] + c[5] * load[5];
            }
        }
        if (a->starts[i] < a->starts[i + 1]) {
            T(fire)(a, s, i, pass, twist);
        }
        for (whole t = a->spans[i]; t < a->spans[i + 1]; t++) {
            const double *bent = a->bent + 43 * t;
            whole own = (a->windowed != NULL) ? a->windowed[t] : -1;
            real value = s->weights[t];
            for (int c = 0; (c < LANES) && (own >= 0) && (own != window); c++) {
                double at[6];
                for (int b = 0; b < 6; b++) {
                    at[b] = AT(borne[b], c);
                }
                AT(counts, c) = draw_in(a->windows + 79 * own, at);
                for (int b = 0; b < 6; b++) {
                    AT(drawn[b], c) = at[b];
                }
            }
            load = (own >= 0) ? drawn : borne;
            if (own >= 0) {
                value *= counts;
            }
            window = own;
            for (whole p = a->pieces[t]; p < a->pieces[t + 1]; p++) {
                const double *shape = a->shapes + 45 * p;
                real part = T(all)(shape[1]);
                if (shape[0] == RAISED) {
                    for (int b = 0; b < 6; b++) {
                        for (int c = 0; c < 6; c++) {
                            part += load[b] * shape[9 + 6 * b + c] * load[c];
                        }
                    }
                    for (int c = 0; c < LANES; c++) {
                        AT(part, c) = pow(fmax(AT(part, c), LEAST), shape[2]);
                    }
                } else {
                    for (int b = 0; b < 6; b++) {
                        part += shape[3 + b] * load[b];
                    }
                    if (shape[0] == TANH) {
                        part = T(bounded)(part);
                    }
                    for (int c = 0; c < LANES; c++) {
                        AT(part, c) = (shape[0] == SIZE) ? fabs(AT(part, c)) : (shape[0] == CLIPPED) ? fmin(fmax(AT(part, c), -1.0), 1.0) : (shape[0] == RAMP) ? fmax(AT(part, c), 0.0) : AT(part, c);
                    }
                }
                value *= part;
            }
            for (int b = 0; b < 6; b++) {
                real given = T(all)(bent[36 + b]);
                for (int c = 0; (c < 6) && (bent[42] > 0.0); c++) {
                    given += bent[6 * b + c] * load[c];
                }
                twist[b] += value * given;
            }
        }
        T(copy)(s->f[i].next, twist, 6);
    }
}

/* Go to the twist that a law gives; return the square of the step. Where a row is at rest (0 of `left`, which is given as
 * long as there is one) it stays. */
static inline real T(go)(T(flexure) *f, const real *twist, int begin, const real *left)
{
    real to[6], by[6];
    for (int b = 0; b < 6; b++) {
        to[b] = twist[b];
        by[b] = begin ? twist[b] : twist[b] - f->twist[b];
    }
    for (int b = 0; (b < 6) && (left != NULL); b++) {
        by[b] *= *left;
        to[b] = f->twist[b] + by[b];
    }
    T(copy)(f->twist, to, 6);
    return T(squares)(by);
}

/* Fill the loads on the flexures, gravity turned back instead of turning the arm, or go to the twists that the laws give
 * under them: return the square of the step. Where it is at rest (0 of `left`, which is given as long as there is such a
 * row) it stays. */
static real T(weigh)(const arm *a, T(state) *s, int flexed, int goes, const real *left)
{
    const whole *order = a->kinds + 2 * a->count;
    const double *gravity = a->elements + 20 * a->count + 12;
    whole n = a->flexures;
    int pushed = a->pushes > 0;
    real moved[3], pull[3], size = T(all)(0.0);
    for (whole i = 0; i < 3; i++) {
        pull[i] = T(all)(gravity[i]);
        moved[i] = T(all)(0.0);
    }
    for (whole step = n - 1; step >= 0; step--) {
        T(flexure) *f = s->f + order[step];
        double mass = a->elements[20 * order[step] + 19];
        for (int i = 0; i < 3; i++) {
            moved[i] += f->moment[i];
            f->lever[i] = moved[i] - mass * f->origin[i];
        }
        if (flexed) {
            T(screw_of)(f);
            T(carry)(f, mass, f->lever, moved);
        }
    }
#if !defined(CONTROLLER)
    pushed |= a->motion != NULL;
#endif /* CONTROLLER */
    for (whole i = 0; (i < n) && pushed; i++) {
        for (int b = 0; b < 6; b++) {
            s->f[i].load[b] = T(all)(0.0);
        }
    }
#if !defined(CONTROLLER)
    if (a->motion != NULL) {
        T(accelerate)(a, s, flexed);
    }
#endif /* CONTROLLER */
    T(push)(a, s, flexed);
    for (whole step = 0; step < n; step++) {
        whole k = order[step];
        T(flexure) *f = s->f + k;
        const double *law = a->compliance + 36 * k, *offset = a->offset + 6 * k;
        double mass = a->elements[20 * k + 19];
        real moment[3], load[6];
        if (flexed) {
            T(lean)(f, -1.0, pull);
        }
        T(cross)(f->lever, pull, moment);
        for (int i = 0; i < 3; i++) {
            load[i] = mass * (f->turn[i] * pull[0] + f->turn[3 + i] * pull[1] + f->turn[6 + i] * pull[2]);
            load[3 + i] = f->turn[i] * moment[0] + f->turn[3 + i] * moment[1] + f->turn[6 + i] * moment[2];
        }
        for (int b = 0; (b < 6) && pushed; b++) {
            load[b] += f->load[b];
        }
        if (goes && f->apart) {
            real twist[6];
            for (int b = 0; b < 6; b++) {
                twist[b] = offset[b] + law[7 * b] * load[b];
            }
            size += T(go)(f, twist, !flexed, left);
        } else {
            T(copy)(f->load, load, 6);
        }
    }
    return size;
}

/* Leave in `pull` how far the twists move the tip, and in `quaternion` how they turn it. */
static void T(displace)(const arm *a, T(state) *s)
{
    real *u = s->quaternion;
    const whole *order = a->kinds + 2 * a->count;
    u[0] = T(all)(1.0);
    u[1] = u[2] = u[3] = s->pull[0] = s->pull[1] = s->pull[2] = T(all)(0.0);
    for (whole step = a->flexures - 1; step >= 0; step--) {
        T(flexure) *f = s->f + order[step];
        real from[3], x, y, z, r = u[0], i = u[1], j = u[2], k = u[3], half, whole_, square;
        T(screw_of)(f);
        for (int b = 0; b < 3; b++) {
            from[b] = s->tip[b] + s->pull[b] - f->origin[b];
        }
        T(carry)(f, 1.0, from, s->pull);
        square = T(dot)(f->twist + 3, f->twist + 3);
        half = 0.5 - square * (1.0 / 48 - square * (1.0 / 3840 - square * (1.0 / 645120)));
        whole_ = 1.0 - square * (1.0 / 8 - square * (1.0 / 384 - square * (1.0 / 46080)));
        x = half * f->screw[3];
        y = half * f->screw[4];
        z = half * f->screw[5];
        u[0] = whole_ * r - (x * i + y * j + z * k);
        u[1] = whole_ * i + r * x + y * k - z * j;
        u[2] = whole_ * j + r * y + z * i - x * k;
        u[3] = whole_ * k + r * z + x * j - y * i;
    }
}

static T(state) T(divide)(const arm *a, double *room)
{
    T(state) s;
    double *at = room;
    memset(&s, 0, sizeof s);
#if !defined(CONTROLLER)
    at = (double *)(((uintptr_t)room + sizeof(neural) - 1) / sizeof(neural) * sizeof(neural));
    s.hidden = (neural *)at;
    at += 2 * WIDE * LANES * a->starts[a->flexures];
#endif /* CONTROLLER */
    s.f = (T(flexure) *)at;
    s.law = (T(law) *)(s.f + a->flexures);
    s.weights = (real *)(s.law + a->flexures);
    s.factor = s.weights + a->terms;
    s.points = s.factor + a->factors;
    s.pushes = s.points + 3 * a->pushes;
#if !defined(CONTROLLER)
    if (a->motion != NULL) {
        s.body = (T(body) *)(s.pushes + 6 * a->pushes);
        s.rates = (real *)(s.body + a->count);
        s.inertial = s.rates + 2 * a->count;
    }
#endif /* CONTROLLER */
    return s;
}

#if !defined(CONTROLLER)
static inline real T(go_on)(T(state) *s, whole n, int begin, const real *left)
{
    real size = T(all)(0.0);
    for (whole i = 0; i < n; i++) {
        if (!s->f[i].apart) {
            size += T(go)(s->f + i, s->f[i].next, begin, left);
        }
    }
    return size;
}

/* Come to rest by the fixed point; fill (LANES) whether that is so. */
static void T(solve)(const arm *a, T(state) *s, int exact, unsigned char *fine)
{
    whole n = a->flexures;
    real size, before, left = T(all)(1.0);
    int moving = 0, held = 0, drawn[LANES] = {0};
    size = T(weigh)(a, s, 0, 1, NULL);
    T(deform)(a, s, 0);
    size += T(go_on)(s, n, 1, NULL);
    for (int c = 0; c < LANES; c++) {
        fine[c] = (AT(size, c) < SMALL) ? 1 : 0;
        AT(left, c) = fine[c];
        moving |= fine[c];
        held |= !fine[c];
    }
    for (whole i = 0; (i < n) && exact && held; i++) {
        for (int b = 0; b < 6 * LANES; b++) {
            real *twist = s->f[i].twist + b / LANES;
            AT(*twist, b % LANES) = fine[b % LANES] ? AT(*twist, b % LANES) : 0.0;
        }
    }
    for (int step = 0; (step < SOFT) && exact && moving; step++) {
        before = size;
        size = T(weigh)(a, s, 1, 1, held ? &left : NULL);
        T(deform)(a, s, step + 1);
        size += T(go_on)(s, n, 0, held ? &left : NULL);
        moving = (step < FEWEST);
        for (int c = 0; (c < LANES) && (step >= FEWEST); c++) {
            if (fine[c] && !drawn[c]) {
                drawn[c] = (AT(size, c) <= CONVERGED) && (AT(size, c) * AT(size, c) <= NEXT * AT(before, c));
                fine[c] = AT(size, c) < SMALL;
                AT(left, c) = fine[c] && !drawn[c];
                moving |= AT(left, c) > 0.0;
                held |= !(AT(left, c) > 0.0);
            }
        }
    }
    size = T(all)(0.0);
    for (whole i = 0; (i < n) && exact; i++) {
        size += T(squares)(s->f[i].twist);
    }
    for (int c = 0; (c < LANES) && exact; c++) {
        fine[c] = fine[c] && drawn[c] && (AT(size, c) < SMALL);
    }
}

/* Look which flexures have a compliance without coupling and nothing else. */
static void T(look)(const arm *a, T(state) *s)
{
    for (whole i = 0; i < a->flexures; i++) {
        int apart = (a->varies[i] == 0) && (a->law_rows <= 1) && (a->starts[i] == a->starts[i + 1]) && (a->spans[i] == a->spans[i + 1]);
        for (int b = 0; (b < 36) && apart; b++) {
            apart = (b % 7 == 0) || (a->compliance[36 * i + b] == 0.0);
        }
        s->f[i].apart = apart;
    }
}

/* Write a row's displacement: of a small turn the vector is by the series of asin x / x. */
static inline void T(write)(const T(state) *s, int c, double *displacement)
{
    double r = AT(s->quaternion[0], c), i = AT(s->quaternion[1], c), j = AT(s->quaternion[2], c), k = AT(s->quaternion[3], c);
    double y = i * i + j * j + k * k, times;
    if ((y < 0.01) && (r > 0.0)) {
        times = 35.0 / 576 + y * (63.0 / 1408 + y * (231.0 / 6656 + y * (143.0 / 5120 + y * (6435.0 / 278528))));
        times = 2.0 + y * (1.0 / 3 + y * (3.0 / 20 + y * (5.0 / 56 + y * times)));
    } else {
        times = 2.0 * atan2(sqrt(y), r) / sqrt(y);
    }
    for (int b = 0; b < 3; b++) {
        displacement[b] = AT(s->pull[b], c);
        displacement[3 + b] = times * AT(s->quaternion[1 + b], c);
    }
}

/* Write numbers of flexures in some rows, whose first is given. */
static inline void T(write_all)(const real *from, whole each, whole n, int rows, double *to)
{
    for (whole i = 0; i < n; i++) {
        for (int c = 0; c < rows; c++) {
            for (int b = 0; b < 6; b++) {
                to[6 * (c * n + i) + b] = AT(from[each * i + b], c);
            }
        }
    }
}

static whole T(chain)(const arm *a, int ready, whole rows, const double *q, int exact, double *displacement, double *loads,
                      double *twists, unsigned char *fine, double *room)
{
    T(state) s = T(divide)(a, room);
    whole n = a->flexures, good = 0, apart = (whole)(sizeof *s.f / sizeof(real));
    int count;
    if (!ready) {
        T(look)(a, &s);
    }
    for (whole first = 0; first < rows; first += LANES) {
        unsigned char some[LANES];
        T(place)(a, &s, rows, q, first);
        if ((first == 0) || (a->factors > 0) || (a->law_rows > 1) || (a->weight_rows > 1)) {
            T(know)(a, &s, rows, q, first);
        }
        T(solve)(a, &s, exact, some);
        if (loads != NULL) {
            (void)T(weigh)(a, &s, exact, 0, NULL);
        }
        T(displace)(a, &s);
        count = (rows - first < LANES) ? (int)(rows - first) : LANES;
        for (int c = 0; c < count; c++) {
            fine[first + c] = some[c];
            good += some[c];
            T(write)(&s, c, displacement + 6 * (first + c));
        }
        if (twists != NULL) {
            T(write_all)(s.f->twist, apart, n, count, twists + 6 * n * first);
        }
        if (loads != NULL) {
            T(write_all)(s.f->load, apart, n, count, loads + 6 * n * first);
        }
    }
    return good;
}
#endif /* CONTROLLER */
