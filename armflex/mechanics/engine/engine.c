/* See engine.h. Chains come to rest by the fixed point, see rest.h; what follows is of any tree, loops and springs
 * among it: where it closes and rests, and how a frame responds. */
#include "engine.h"
#include <math.h>
#include <stddef.h>
#include <string.h>
#if defined(__x86_64__) && defined(__GNUC__) && !defined(CONTROLLER)
#include <cpuid.h>
enum { LEAF_1 = 0x38401000, LEAF_7 = 0x128, LZCNT = 0x20 }; /* FMA, MOVBE, OSXSAVE, AVX, F16C; BMI1, AVX2, BMI2 */
static const unsigned LEAF_7_WIDE = 0xd0030000;             /* AVX-512 F, DQ, CD, BW, VL */
#endif

enum { FLEXURE, TURNS, SLIDES, RIGID, ROTATED };
enum { ROD = 4, GEAR, COIL, GAS };
enum { PART, SIZE, CLIPPED, TANH, RAISED, RAMP };
enum { SPRING = 1, MAGNET };
enum { ONE, POWER, SINE, COSINE, STEP, BUMP, TENT, CREEP, OVERLAP, CHEBYSHEV, TABLE };
enum { STEPS = 24, MOST = 50, FEWEST = 2, SOFT = 96, TIP = 8, BOTH = 12, SOLVED = 20 }; /* see branches */
static const double CONVERGED = 1e-24;
#if !defined(CHAIN)
static const double SMALL = 0.1 * 0.1;
#endif /* CHAIN */

/* ---- Packs ------------------------------------------------------------------------------------------------------ */

enum { WIDE = 4 };
#if defined(__AVX512F__)
enum { MANY = 8 }; /* rows side by side */
#else
enum { MANY = WIDE };
#endif
#if defined(__GNUC__) && !defined(PLAIN)
#define PACKED 1
typedef double pack __attribute__((vector_size(32)));
typedef uint64_t bits __attribute__((vector_size(32)));
typedef double loose __attribute__((vector_size(32), aligned(8)));
static inline pack get(const double *from) { return *(const loose *)from; }
static inline void put(double *to, pack v) { *(loose *)to = v; }
static inline pack spread(double x) { return (pack){x, x, x, x}; }
static inline pack all_four(double x) { return x - (pack){0.0}; } /* of -0, too */
static inline pack add(pack a, pack b) { return a + b; }
static inline pack sub(pack a, pack b) { return a - b; }
static inline pack mul(pack a, pack b) { return a * b; }
static inline pack scale(double s, pack a) { return s * a; }
#else
#if !defined(PROVEN)
typedef struct { double v[4]; } pack;
static inline pack get(const double *from) { pack p; for (int i = 0; i < 4; i++) p.v[i] = from[i]; return p; }
static inline void put(double *to, pack p) { for (int i = 0; i < 4; i++) to[i] = p.v[i]; }
static inline pack spread(double x) { pack p; for (int i = 0; i < 4; i++) p.v[i] = x; return p; }
static inline pack add(pack a, pack b) { for (int i = 0; i < 4; i++) a.v[i] += b.v[i]; return a; }
static inline pack sub(pack a, pack b) { for (int i = 0; i < 4; i++) a.v[i] -= b.v[i]; return a; }
static inline pack mul(pack a, pack b) { for (int i = 0; i < 4; i++) a.v[i] *= b.v[i]; return a; }
static inline pack scale(double s, pack a) { for (int i = 0; i < 4; i++) a.v[i] *= s; return a; }
#endif /* PROVEN */
#endif

/* A cubic through values at equally spaced knots, with the slope of a parabola at the ends: see laws.terms. */
static double table_at(const double *values, whole count, int round_, double x)
{
    double u = x, t, before, left, right, after;
    whole k;
    if (!(fabs(u) < 1e15)) {
        return u - u; /* not a number */
    }
    u = round_ ? u - (double)count * floor(u / (double)count) : fmin(fmax(u, 0.0), (double)(count - 1));
    k = (whole)u;
    k = (k < (round_ ? count - 1 : count - 2)) ? k : (round_ ? count - 1 : count - 2);
    t = u - (double)k;
    left = values[k];
    right = values[(k + 1) % count];
    if (round_) {
        before = values[(k + count - 1) % count];
        after = values[(k + 2) % count];
    } else {
        double bent = (count > 2) ? 1.0 : 0.0;
        before = (k > 0) ? values[k - 1] : (2.0 + bent) * left - (1.0 + 2.0 * bent) * right + bent * values[(k + 2) % count];
        after = (k < count - 2) ? values[k + 2] : (2.0 + bent) * right - (1.0 + 2.0 * bent) * left + bent * values[(k + count - 1) % count];
    }
    return left + 0.5 * t * (right - before + t * (2.0 * before - 5.0 * left + 4.0 * right - after
                                                   + t * (3.0 * (left - right) + after - before)));
}

static double factor_at(const double *f, const double *knots, double x)
{
    double a = f[2], b = f[3], c = f[4], d = f[5], value = 1.0;
    switch ((int)f[0]) {
    case POWER:
        for (int i = 0; i < (int)c; i++) {
            value *= (x - a) / b;
        }
        break;
    case SINE: value = sin(a * x); break;
    case COSINE: value = cos(a * x); break;
    case STEP: value = (x >= a) ? 1.0 : 0.0; break;
    case BUMP: value = exp(-0.5 * ((x - a) / b) * ((x - a) / b)); break;
    case TENT: value = fmax(1.0 - fabs((fmin(fmax(x, a), b) - a) / c - d), 0.0); break;
    case CREEP: value = log1p(fmax(x, 0.0) / a); break;
    case OVERLAP: value = 1.0 / (a + fabs(x - b)); break;
    case CHEBYSHEV: {
        double y = (x - a) / b, next = y;
        for (int i = 0; i < (int)c; i++) {
            double after = 2.0 * y * next - value;
            value = next;
            next = after;
        }
        break;
    }
    case TABLE: value = table_at(knots + (whole)c, (whole)fabs(d), d < 0.0, (x - a) / b); break;
    default: break;
    }
    return value;
}

/* ---- Chains ------------------------------------------------------------------------------------------------------ */

#if !defined(LOOPS)
static const double NEXT = 4e-30, LEAST = 1e-300, NEAREST = 1e-9;
static const double TURN = 6.283185307179586, TURN_REST = 2.4492935982947064e-16, TURNS_PER_RADIAN = 0.15915494309189535;

#if defined(CONTROLLER)
/* tanh to 2e-16: a controller has exp, and its compiler need not make packs of this. */
static inline double bounded_one(double x)
{
    return 1.0 - 2.0 / (exp(2.0 * x) + 1.0);
}
#else
static const double HALVINGS = 1.4426950408889634, LOG_2_ROUND = 0.6931471803691238, LOG_2_REST = 1.9082149292705877e-10;
static const double LARGE = 1.5 * 4503599627370496.0, NEAR = 1.0 / 64, CLOSE = 1e-4;

/* tanh to 4e-16 without branches: the halvings of exp(-2 |x|) are the last bits of a sum with a large number. */
#define BOUNDED(name, real, bits, nearest, size, sign, power_of)                                                        \
    static inline real name(real x)                                                                                     \
    {                                                                                                                   \
        real y = -2.0 * size(x), halvings = nearest(y * HALVINGS);                                                       \
        real r = (y - halvings * LOG_2_ROUND) - halvings * LOG_2_REST, power = power_of(halvings), s = r * r, odd, less;     \
        odd = 1.0 / 5040 + s * (1.0 / 362880 + s * (1.0 / 39916800 + s * (1.0 / 6227020800.0)));                         \
        odd = r + r * s * (1.0 / 6 + s * (1.0 / 120 + s * odd));                                                        \
        less = 1.0 / 40320 + s * (1.0 / 3628800 + s * (1.0 / 479001600));                                               \
        less = odd + s * (1.0 / 2 + s * (1.0 / 24 + s * (1.0 / 720 + s * less)));                                       \
        less = power * less + (power - 1.0);                                                                            \
        return sign(less / (2.0 + less), x);                                                                            \
    }

static inline double least_one(double x)
{
    return fmin(fabs(x), 20.0);
}
static inline double power_one(double halvings)
{
    double large = halvings + LARGE, power;
    uint64_t i;
    memcpy(&i, &large, sizeof i);
    i = (i + 1023) << 52;
    memcpy(&power, &i, sizeof power);
    return power;
}
BOUNDED(bounded_one, double, whole, rint, least_one, copysign, power_one)
#endif /* CONTROLLER */

/* Fill the force [N] of a pull at a point in base axes: a spring, slack where it is shorter than it wants to be, or a
 * magnet, whose pull falls with the square of the distance but for a reach. */
static void pull_at(const double *pull, const double *at, double *force)
{
    double way[3] = {0.0}, distance, size;
    for (int i = 0; i < 3; i++) {
        way[i] = pull[1 + i] - at[i];
    }
    distance = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
    if (pull[0] == SPRING) {
        size = pull[4] * fmax(distance - pull[5], 0.0) / fmax(distance, NEAREST);
    } else {
        size = pull[4] / fmax(distance * distance + pull[5] * pull[5], 1e3 * NEAREST) / fmax(distance, NEAREST);
    }
    for (int i = 0; i < 3; i++) {
        force[i] = size * way[i];
    }
}

/* Draw a load in to those under which a correction was learned, and return how much of the correction counts: all where
 * the load is among those; beyond them the correction is carried on to twice as far, and fades. */
static double draw_in(const double *window, double *load)
{
    const double *mean = window, *precision = window + 6, *energy = window + 42;
    double off[6], square = 0.0, reach = 0.0, weight = 1.0, faded = window[78];
    for (int i = 0; i < 6; i++) {
        off[i] = load[i] - mean[i];
    }
    for (int i = 0; i < 36; i++) {
        square += off[i / 6] * precision[i] * off[i % 6];
        reach += off[i / 6] * energy[i] * off[i % 6];
    }
    if (square > 1.0) {
        double distance = sqrt(square), share = (1.0 + tanh(distance - 1.0)) / distance;
        for (int i = 0; i < 6; i++) {
            load[i] = mean[i] + share * off[i];
        }
        if (faded > 1.0) { /* otherwise it never fades */
            double left = fmin(fmax((faded - sqrt(fmax(reach, 0.0))) / (faded - 1.0), 0.0), 1.0);
            weight = left * left * left * (10.0 - 15.0 * left + 6.0 * left * left);
        }
    }
    return weight;
}

#if !defined(CONTROLLER)
#if defined(PACKED)
/* What tanh takes, of packs of so many numbers; `nearest` calls nothing where a processor has no instruction for it. */
#define PARTS(name, pack, bits, all)                                                                             \
    static inline pack nearest_##name(pack x)                                                                           \
    {                                                                                                                   \
        return (x + LARGE) - LARGE;                                                                                     \
    }                                                                                                                   \
    static inline int exceeds_##name(pack x, double most)                                                               \
    {                                                                                                                   \
        int over = 0;                                                                                                   \
        for (int i = 0; i < (int)(sizeof(pack) / sizeof(double)); i++) {                                                \
            over |= (x[i] > most);                                                                                      \
        }                                                                                                               \
        return over;                                                                                                    \
    }                                                                                                                   \
    static inline pack least_##name(pack x)                                                                             \
    {                                                                                                                   \
        pack size = (pack)((bits)x & ~(bits)all(-0.0)), most = all(20.0);                                               \
        bits over = (bits)(size > most);                                                                                \
        return (pack)(((bits)most & over) | ((bits)size & ~over));                                                      \
    }                                                                                                                   \
    static inline pack sign_##name(pack size, pack x)                                                                   \
    {                                                                                                                   \
        bits mask = (bits)all(-0.0);                                                                                    \
        return (pack)(((bits)size & ~mask) | ((bits)x & mask));                                                         \
    }                                                                                                                   \
    static inline pack power_##name(pack halvings)                                                                      \
    {                                                                                                                   \
        return (pack)(((bits)(halvings + LARGE) + 1023) << 52);                                                         \
    }                                                                                                                   \
    BOUNDED(bounded_##name, pack, bits, nearest_##name, least_##name, sign_##name, power_##name)

PARTS(four, pack, bits, all_four)
#if defined(__AVX512F__)
typedef double wide_pack __attribute__((vector_size(64)));
typedef uint64_t wide_bits __attribute__((vector_size(64)));
static inline wide_pack all_many(double x) { return x - (wide_pack){0.0}; }
PARTS(many, wide_pack, wide_bits, all_many)
#define real wide_pack
#else
#define all_many all_four
#define nearest_many nearest_four
#define bounded_many bounded_four
#define exceeds_many exceeds_four
#define real pack
#endif
#define LANES MANY
#define T(name) name##_many
#define AT(v, c) ((v)[c])
#define EACH 1
#define neural real
#define N(name) name##_many
#define weight(from) all_many(*(from))
#define given(x) (x)
#define gathered(x) (x)
#include "rest.h"
#undef LANES
#undef real
#undef T
#undef AT
#undef EACH
#undef neural
#undef N
#undef weight
#undef given
#undef gathered
#define EACH WIDE
#define neural pack
#define N(name) name##_four
#define weight(from) get(from)
#define given(x) all_four(x)
#define gathered(x) (((x)[0] + (x)[1]) + ((x)[2] + (x)[3]))
#endif
#endif /* CONTROLLER */
#if !defined(PACKED)
static inline int exceeds_one(double x, double most)
{
    return x > most;
}
#define EACH 1
#define neural double
#define N(name) name##_one
#define weight(from) (*(from))
#define given(x) (x)
#define gathered(x) (x)
#endif
#define LANES 1
#define real double
#define T(name) name##_one
#define AT(v, c) (*((void)(c), &(v)))
#define nearest_one(x) rint(x)
#define all_one(x) (x)
#include "rest.h"
#undef LANES
#undef real
#undef T
#undef AT
#endif /* LOOPS */

/* ---- Equations of packs of four columns ----------------------------------------------------------------------------- */

#if !defined(PROVEN)
static inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static inline double dot6(const double *a, const double *b) { return dot(a, b) + dot(a + 3, b + 3); }
static inline void swap_rows(double *a, double *b, whole wide)
{
    for (whole c = 0; (c < wide) && (a != b); c += WIDE) {
        pack one = get(a + c), other = get(b + c);
        put(a + c, other);
        put(b + c, one);
    }
}

/* Factor a matrix of n rows of `wide` numbers, with one more row to work in; return whether it is regular. */
static int factor(double *matrix, whole n, whole wide, whole *order)
{
    double *pivot = matrix + n * wide;
    for (whole c = 0; c < n; c++) {
        whole best = c, first = c / WIDE * WIDE;
        double own;
        for (whole r = c + 1; r < n; r++) {
            if (fabs(matrix[r * wide + c]) > fabs(matrix[best * wide + c])) {
                best = r;
            }
        }
        order[c] = best;
        if (!(fabs(matrix[best * wide + c]) > 0.0)) {
            for (whole r = c + 1; r < n; r++) { /* whoever solves it all the same gets what is no number */
                order[r] = r;
            }
            return 0;
        }
        swap_rows(matrix + c * wide, matrix + best * wide, wide);
        for (whole b = first; b < wide; b++) {
            pivot[b] = (b > c) ? matrix[c * wide + b] : 0.0;
        }
        own = 1.0 / matrix[c * wide + c];
        for (whole r = c + 1; r < n; r++) {
            double *row = matrix + r * wide, by = own * row[c];
            if (row[c] != 0.0) {
                for (whole b = first; b < wide; b += WIDE) {
                    put(row + b, sub(get(row + b), scale(by, get(pivot + b))));
                }
                row[c] = by;
            }
        }
    }
    return 1;
}

static inline pack left(const double *row, const double *right, whole a, whole first, whole last, whole c, whole width)
{
    pack value = get(right + a * width + c), other = spread(0.0);
    for (whole b = first; b < last - 1; b += 2) {
        value = sub(value, scale(row[b], get(right + b * width + c)));
        other = sub(other, scale(row[b + 1], get(right + (b + 1) * width + c)));
    }
    if (((last - first) & 1) != 0) {
        value = sub(value, scale(row[last - 1], get(right + (last - 1) * width + c)));
    }
    return add(value, other);
}

/* Put the solution of a factored system into its right sides, n rows of `width`. */
static void solve(const double *matrix, whole n, whole wide, const whole *order, double *right, whole width)
{
    for (whole a = 0; a < n; a++) {
        swap_rows(right + a * width, right + order[a] * width, width);
    }
    for (whole c = 0; c < width; c += WIDE) {
        for (whole a = 0; a < n; a++) {
            put(right + a * width + c, left(matrix + a * wide, right, a, 0, a, c, width));
        }
        for (whole a = n - 1; a >= 0; a--) {
            put(right + a * width + c, scale(1.0 / matrix[a * wide + a], left(matrix + a * wide, right, a, a + 1, n, c, width)));
        }
    }
}

/* Whether a square matrix with a share of the unit matrix is positive: Cholesky of its even part. */
static int positive(const double *stiff, whole n, whole wide, double by, double *lower, whole width)
{
    for (whole r = 0; r < n; r++) {
        for (whole c = 0; c <= r; c++) {
            double value = 0.5 * (stiff[r * wide + c] + stiff[c * wide + r]);
            for (whole i = 0; i < c; i++) {
                value -= lower[r * width + i] * lower[c * width + i];
            }
            if (c < r) {
                lower[r * width + c] = value / lower[c * width + c];
            } else if (value + by > 0.0) {
                lower[r * width + r] = sqrt(value + by);
            } else {
                return 0;
            }
        }
    }
    return 1;
}
#endif /* PROVEN */

#if !defined(CHAIN)
static const double SLOWEST = 0.1;
static const double SHARE = 0.1, ALIGNED = 1e-4, ASSEMBLED = 2e-3, CLOSED = 1e-13, LONGEST = 0.5, ROUNDED = 1e-9;
static const double SHORTEST = 1e-9, NEAR_SINGULAR = 1e-8, ROUNDING = 1e-12, ENDS = 1e-28, SQUARED = 1e-8;

/* ---- Vectors, and packs of four columns ------------------------------------------------------------------------- */

typedef struct { pack x, y, z; } packs;

static inline packs columns(const double *from, whole width) { return (packs){get(from), get(from + width), get(from + 2 * width)}; }
static inline packs spread3(const double *v) { return (packs){spread(v[0]), spread(v[1]), spread(v[2])}; }
static inline packs crossed(packs a, packs b)
{
    return (packs){sub(mul(a.y, b.z), mul(a.z, b.y)), sub(mul(a.z, b.x), mul(a.x, b.z)), sub(mul(a.x, b.y), mul(a.y, b.x))};
}
static inline packs sum(packs a, packs b) { return (packs){add(a.x, b.x), add(a.y, b.y), add(a.z, b.z)}; }
static inline packs less(packs a, packs b) { return (packs){sub(a.x, b.x), sub(a.y, b.y), sub(a.z, b.z)}; }
static inline packs share(pack s, packs a) { return (packs){mul(s, a.x), mul(s, a.y), mul(s, a.z)}; }
static inline void put_columns(double *to, whole width, packs v)
{
    put(to, v.x);
    put(to + width, v.y);
    put(to + 2 * width, v.z);
}
static inline void add_columns(double *to, whole width, packs v)
{
    put(to, add(get(to), v.x));
    put(to + width, add(get(to + width), v.y));
    put(to + 2 * width, add(get(to + 2 * width), v.z));
}
/* What a rotation makes this vector of. */
static inline packs back_turned(const double *turn, whole row, packs v)
{
    packs out;
    out.x = add(add(scale(turn[0], v.x), scale(turn[row], v.y)), scale(turn[2 * row], v.z));
    out.y = add(add(scale(turn[1], v.x), scale(turn[row + 1], v.y)), scale(turn[2 * row + 1], v.z));
    out.z = add(add(scale(turn[2], v.x), scale(turn[row + 2], v.y)), scale(turn[2 * row + 2], v.z));
    return out;
}

static inline void cross(const double *a, const double *b, double *out)
{
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}
static inline void turned(const double *turn, const double *v, double *out)
{
    double x = dot(turn, v), y = dot(turn + 3, v), z = dot(turn + 6, v);
    out[0] = x;
    out[1] = y;
    out[2] = z;
}
static inline void turned_back(const double *turn, const double *v, double *out)
{
    double x = v[0], y = v[1], z = v[2];
    for (int i = 0; i < 3; i++) {
        out[i] = turn[i] * x + turn[3 + i] * y + turn[6 + i] * z;
    }
}
/* A row of a rotation times that of a frame. */
static inline void through(const double *row, const double *frame, double *out)
{
    turned_back(frame, row, out);
}
static inline whole wide_of(whole count) { return (count + WIDE - 1) / WIDE * WIDE; }
static inline void fill(double *to, whole count) { memset(to, 0, (size_t)count * sizeof(double)); }

/* ---- Memory ----------------------------------------------------------------------------------------------------- */

typedef struct { /* where a mechanism is; see the kernel of trees */
    double *turn, *origin, *screws, *roots, *loads, *twists, *load, *gaps, *forces, *ways, *by, *pairs, *lengths, *y, *angles;
    whole *carriers, *owner, *begins, rank; /* begins: of the coordinates of each flexure */
} here;
typedef struct {
    double *motion, *field, *unit, *stiff, *matrix, *right, *laws, *small, *inverse;
    whole *order, total, wide, side, most; /* coordinates; widths of rows: unit and stiff, matrix, small and inverse */
} work;

#if defined(__SANITIZE_ADDRESS__) && !defined(CONTROLLER)
#include <sanitizer/asan_interface.h>
enum { GAP = 8 }; /* between arrays in the same memory, so that one that is overrun is found */
#else
enum { GAP = 0 };
#endif

/* The caller's memory as it was lent, without gaps. */
static void whole_again(const arm *a, double *room)
{
#if defined(__SANITIZE_ADDRESS__) && !defined(CONTROLLER)
    ASAN_UNPOISON_MEMORY_REGION(room, (size_t)engine_room(a) * sizeof *room);
#endif
    (void)a;
    (void)room;
}

static double *take(double **room, whole count)
{
    double *own = *room;
    *room += count + GAP;
#if defined(__SANITIZE_ADDRESS__) && !defined(CONTROLLER)
    ASAN_UNPOISON_MEMORY_REGION(own, (size_t)count * sizeof *own);
    ASAN_POISON_MEMORY_REGION(own + count, GAP * sizeof *own);
#endif
    return own;
}

static double *zeroed(double **room, whole count)
{
    double *own = take(room, count);
    fill(own, count);
    return own;
}

static here memory(const arm *a, double **room)
{
    here h;
    whole k = a->count, n = a->flexures, m = a->rows, t = a->ties, z = a->driven + a->passive + 6 * n;
    h.turn = zeroed(room, 9 * k);
    h.origin = zeroed(room, 3 * k);
    h.screws = zeroed(room, 6 * z);
    h.roots = zeroed(room, 36 * n);
    h.loads = zeroed(room, 6 * k);
    h.twists = zeroed(room, 6 * n);
    h.load = zeroed(room, 6 * n);
    h.gaps = zeroed(room, m);
    h.forces = zeroed(room, m);
    h.ways = zeroed(room, 6 * (m + t));
    h.by = zeroed(room, m * (a->passive + 6 * n));
    h.pairs = zeroed(room, 18 * t);
    h.lengths = zeroed(room, t);
    h.y = zeroed(room, 6 * n);
    h.angles = zeroed(room, 3 * k);
    h.carriers = (whole *)zeroed(room, z);
    h.owner = (whole *)zeroed(room, 6 * n);
    h.begins = (whole *)zeroed(room, n + 1);
    h.rank = 0;
    h.turn[0] = h.turn[4] = h.turn[8] = 1.0;
    for (whole e = 1; e < k; e++) {
        whole kind = a->kinds[e] & 3;
        if ((kind == TURNS) || (kind == SLIDES)) {
            h.carriers[a->kinds[k + e]] = e;
        }
    }
    return h;
}

/* Divide room for p passive joints and `rank` coordinates of laws. */
static work divided(const arm *a, whole p, whole rank, double **room)
{
    work w;
    whole m = a->rows, size = p + rank + m, most = (p + rank > m) ? p + rank : m;
    w.total = p + rank;
    w.wide = wide_of(w.total);
    w.side = wide_of(size);
    w.most = wide_of(most);
    w.motion = take(room, a->count * 6 * w.wide);
    w.field = take(room, a->count * 6 * w.wide);
    w.unit = take(room, w.total * w.wide);
    w.stiff = take(room, w.total * w.wide);
    w.matrix = take(room, (size + 1) * w.side);
    w.right = take(room, size * WIDE);
    w.laws = take(room, size * wide_of(rank));
    w.small = take(room, (most + 1) * w.most);
    w.inverse = take(room, most * w.most);
    w.order = (whole *)take(room, size);
    fill(w.unit, w.total * w.wide);
    for (whole z = 0; z < w.total; z++) {
        w.unit[z * w.wide + z] = 1.0;
    }
    fill(w.stiff, w.total * w.wide);
    fill(w.matrix, (size + 1) * w.side);
    fill(w.right, size * WIDE);
    fill(w.laws, size * wide_of(rank));
    fill(w.small, (most + 1) * w.most);
    return w;
}

#if !defined(CONTROLLER)
/* What `divided` takes for p passive joints and `rank` coordinates, at most. */
static whole divided_room(const arm *a, whole rank)
{
    whole size = a->passive + rank + a->rows, wide = wide_of(size);
    return 2 * a->count * 6 * wide + 8 * (size + 2) * wide + 2 * size;
}

/* What all but chains take where laws have `rank` coordinates at most. */
whole engine_rest_room(const arm *a, whole rank)
{
    whole k = a->count, n = a->flexures, m = a->rows, t = a->ties, p = a->passive, z = a->driven + p + 6 * n;
    whole here_ = 21 * k + 8 * z + 36 * n + 36 * n + 2 * m + 6 * (m + t) + m * (p + 6 * n) + 19 * t + 24 * n + 64;
    whole respond = 36 * n * 3 + m * (p + 6 * n) + 6 * (p + 6 * n) + 8 * (p + 6 * n + m) + 2 * 6 * TIP * (k + 2) + k + 256;
    respond += (t == 0) ? 6 * BOTH * k + 6 * (7 * TIP + SOLVED) * n + 2 * WIDE : 0;
    return here_ + divided_room(a, 0) + divided_room(a, rank) + respond + 2 * m * m + 64 * GAP;
}

whole engine_room(const arm *a)
{
    whole n = a->flexures, numbers = 2 * WIDE * a->starts[n] + 109 * n + 17 * a->count + a->terms + a->factors + 9 * a->pushes + 32;
    return MANY * numbers + engine_rest_room(a, 6 * n);
}
#endif /* CONTROLLER */

/* ---- Where it is ------------------------------------------------------------------------------------------------ */

/* Fill the frame that exp6 of a twist is: rotation row by row, and origin. */
static void exponential(const double *twist, double *frame)
{
    const double *turn = twist + 3;
    double s = dot(turn, turn), second, third, once[3], twice[3];
    if (s < 0.02) {
        second = 0.5 - s * (1.0 / 24 - s * (1.0 / 720 - s / 40320));
        third = 1.0 / 6 - s * (1.0 / 120 - s * (1.0 / 5040 - s / 362880));
    } else {
        double angle = sqrt(s), half = sin(0.5 * angle);
        second = 2.0 * half * half / s;
        third = (angle - sin(angle)) / (s * angle);
    }
    cross(turn, twist, once);
    cross(turn, once, twice);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double along = (1.0 - third * s) * turn[k], both = second * turn[i] * turn[j];
        frame[9 + i] = twist[i] + second * once[i] + third * twice[i];
        frame[4 * i] = 1.0 - second * (turn[j] * turn[j] + turn[k] * turn[k]);
        frame[3 * i + j] = both - along;
        frame[3 * j + i] = both + along;
    }
}

static inline double position(const arm *a, const double *q, const double *loose_joints, whole k)
{
    whole own = a->kinds[a->count + k];
    return (own < a->driven) ? q[own] : loose_joints[own - a->driven];
}

/* Fill the spatial twist of one in the axes of an element. */
static void screw(const here *h, whole k, const double *twist, double *found)
{
    double about[3], way[3], lever[3];
    turned(h->turn + 9 * k, twist + 3, about);
    turned(h->turn + 9 * k, twist, way);
    cross(h->origin + 3 * k, about, lever);
    for (int i = 0; i < 3; i++) {
        found[i] = way[i] + lever[i];
        found[3 + i] = about[i];
    }
}

/* Fill `turn`, `origin` and the `screws` of joints; flexures are at rest unless it is `flexed`. */
static void place(const arm *a, const double *q, const double *loose_joints, int flexed, here *h)
{
    for (whole k = 1; k < a->count; k++) {
        whole kind = a->kinds[k] & 3, own = a->kinds[a->count + k], back = a->parents[k];
        const double *local = a->elements + 20 * k, *axis = local + 12;
        double value = 0.0, *known = h->angles + 3 * k, *s = h->screws + 6 * ((own > 0) ? own : 0), frame[12];
        if ((kind == FLEXURE) && flexed) {
            exponential(h->twists + 6 * own, frame);
        } else if ((kind == TURNS) || (kind == SLIDES)) {
            value = position(a, q, loose_joints, k);
            if (value != known[0]) {
                double half = sin(0.5 * value);
                known[0] = value;
                known[1] = 2.0 * half * cos(0.5 * value);
                known[2] = 2.0 * half * half;
            }
        }
        for (int i = 0; i < 3; i++) {
            double row[3], at;
            memcpy(row, h->turn + 9 * back + 3 * i, sizeof row);
            at = h->origin[3 * back + i] + dot(row, local + 9);
            if ((a->kinds[k] & ROTATED) != 0) {
                through(row, local, row);
            }
            if ((kind == FLEXURE) && flexed) {
                at += dot(row, frame + 9);
                through(row, frame, row);
            } else if (kind == TURNS) {
                double part = s[3 + i] = dot(row, axis), across[3];
                cross(row, axis, across);
                for (int j = 0; j < 3; j++) {
                    row[j] += known[1] * across[j] + known[2] * (part * axis[j] - row[j]);
                }
            } else if (kind == SLIDES) {
                s[i] = dot(row, axis);
                at += value * s[i];
            }
            memcpy(h->turn + 9 * k + 3 * i, row, sizeof row);
            h->origin[3 * k + i] = at;
        }
        if (kind == TURNS) {
            cross(h->origin + 3 * k, s + 3, s);
        }
    }
}

/* Fill the screws of the coordinates of laws, along rows of R or S. */
static void place_laws(const arm *a, const here *h, const double *roots, double *screws)
{
    for (whole c = 0; c < h->rank; c++) {
        whole k = h->carriers[a->driven + a->passive + c];
        if (k > 0) {
            screw(h, k, roots + 6 * c, screws + 6 * c);
        }
    }
}

static inline void point_of(const here *h, whole k, const double *point, double *out)
{
    double by[3];
    turned(h->turn + 9 * k, point, by);
    for (int i = 0; i < 3; i++) {
        out[i] = h->origin[3 * k + i] + by[i];
    }
}

/* Fill `gaps`, `ways`, `pairs` and `lengths`; return whether all rods have a length. */
static int join(const arm *a, const double *q, const double *loose_joints, here *h)
{
    for (whole t = 0; t < a->ties; t++) {
        const whole *j6 = a->joins + 6 * t;
        whole kind = j6[0], e1 = j6[1], e2 = j6[2], start = j6[3], end = j6[4];
        const double *tie = a->tie + 45 * t;
        double *pairs = h->pairs + 18 * t, one[3], two[3], apart[3];
        if (kind == GEAR) {
            h->gaps[start] = position(a, q, loose_joints, e1) - tie[24] * position(a, q, loose_joints, e2) - tie[25];
            continue;
        }
        point_of(h, e1, tie, one);
        point_of(h, e2, tie + 3, two);
        for (int i = 0; i < 3; i++) {
            apart[i] = two[i] - one[i];
        }
        if (kind >= ROD) {
            double length = h->lengths[t] = sqrt(dot(apart, apart)), *way = h->ways + 6 * start;
            if (!(length > SHORTEST)) {
                return 0;
            }
            for (int i = 0; i < 3; i++) {
                way[i] = apart[i] / length;
            }
            cross(two, way, way + 3);
            if (kind == ROD) {
                h->gaps[start] = length - q[j6[5]] - tie[24];
            }
            continue;
        }
        for (whole j = 0; j < kind; j++) {
            turned(h->turn + 9 * e1, tie + 6 + 3 * j, pairs + 3 * j);
            turned(h->turn + 9 * e2, tie + 15 + 3 * j, pairs + 9 + 3 * j);
        }
        for (whole r = start; r < end; r++) {
            double across[3], about[3], moment[3], gap;
            turned(h->turn + 9 * e1, a->way + 6 * r, across);
            turned(h->turn + 9 * e1, a->way + 6 * r + 3, about);
            gap = dot(across, apart);
            cross(two, across, moment);
            for (whole j = 0; j < kind; j++) {
                double ab[3], back[3];
                cross(pairs + 3 * j, pairs + 9 + 3 * j, ab);
                gap += dot(about, ab);
                cross(about, pairs + 3 * j, back);
                cross(pairs + 9 + 3 * j, back, back);
                for (int i = 0; i < 3; i++) {
                    moment[i] += back[i];
                }
            }
            h->gaps[r] = gap;
            memcpy(h->ways + 6 * r, across, sizeof across);
            memcpy(h->ways + 6 * r + 3, moment, sizeof moment);
        }
    }
    for (whole i = 0; i < a->flexures; i++) {
        if (a->flexure[i] < 0) {
            const whole *j6 = a->joins + 6 * (-1 - a->flexure[i]);
            for (whole r = j6[3]; r < j6[4]; r++) {
                h->gaps[r] -= dot6(a->row + 6 * r, h->twists + 6 * i);
            }
        }
    }
    return 1;
}

/* Fill the change of the gaps by (Z, 6) twists of coordinates, of closures by (y, 6) twists; rows of `width`. */
static void open_gaps(const arm *a, const here *h, const double *screws, whole count, const double *roots, whole rank, double *by)
{
    whole p = count - rank, width = count;
    for (whole z = 0; z < count; z++) {
        whole k = h->carriers[a->driven + z];
        for (whole r = 0; r < a->rows; r++) {
            by[r * width + z] = 0.0;
        }
        for (whole t = 0; t < a->ties; t++) {
            double sign = a->carried[t * a->count + k];
            for (whole r = a->joins[6 * t + 3]; (r < a->joins[6 * t + 4]) && (sign != 0.0); r++) {
                by[r * width + z] = sign * dot6(h->ways + 6 * r, screws + 6 * z);
            }
        }
        if (k == 0) {
            const whole *j6 = a->joins + 6 * (-1 - a->flexure[h->owner[z - p]]);
            for (whole r = j6[3]; r < j6[4]; r++) {
                by[r * width + z] = -dot6(a->row + 6 * r, roots + 6 * (z - p));
            }
        }
    }
    for (whole t = 0; t < a->ties; t++) {
        const whole *j6 = a->joins + 6 * t;
        if (j6[0] == GEAR) {
            whole own = a->kinds[a->count + j6[1]] - a->driven, master = a->kinds[a->count + j6[2]] - a->driven;
            by[j6[3] * width + own] = 1.0;
            if (master >= 0) {
                by[j6[3] * width + master] = -a->tie[45 * t + 24];
            }
        }
    }
}

/* ---- Equations of closed loops ------------------------------------------------------------------------------------ */

/* Eigenvalues (diagonal of the matrix) and vectors (columns) of a symmetric (n, n) matrix, by Jacobi's rotations. */
static void eigen(double *matrix, whole n, double *vectors)
{
    fill(vectors, n * n);
    for (whole i = 0; i < n; i++) {
        vectors[i * n + i] = 1.0;
    }
    for (int sweep = 0; sweep < 30; sweep++) {
        double off = 0.0, on = 0.0;
        for (whole i = 0; i < n; i++) {
            for (whole j = 0; j < n; j++) {
                *((i == j) ? &on : &off) += matrix[i * n + j] * matrix[i * n + j];
            }
        }
        if (!(off > 1e-34 * on)) {
            break;
        }
        for (whole i = 0; i < n; i++) {
            for (whole j = i + 1; j < n; j++) {
                double x = matrix[i * n + j], theta, t, c, s;
                if (x == 0.0) {
                    continue;
                }
                theta = (matrix[j * n + j] - matrix[i * n + i]) / (2.0 * x);
                t = copysign(1.0 / (fabs(theta) + sqrt(theta * theta + 1.0)), theta);
                c = 1.0 / sqrt(t * t + 1.0);
                s = t * c;
                for (whole k = 0; k < n; k++) {
                    double p = matrix[k * n + i], q = matrix[k * n + j];
                    matrix[k * n + i] = c * p - s * q;
                    matrix[k * n + j] = s * p + c * q;
                }
                for (whole k = 0; k < n; k++) {
                    double p = matrix[i * n + k], q = matrix[j * n + k];
                    matrix[i * n + k] = c * p - s * q;
                    matrix[j * n + k] = s * p + c * q;
                }
                for (whole k = 0; k < n; k++) {
                    double p = vectors[k * n + i], q = vectors[k * n + j];
                    vectors[k * n + i] = c * p - s * q;
                    vectors[k * n + j] = s * p + c * q;
                }
            }
        }
    }
}

/* Move passive joints to where the loops close, by steps that may be long at first where it `jumps`; return whether
 * the reference would say the same. */
static int close_loops(const arm *a, const double *q, int jumps, double *loose_joints, here *h, work *w)
{
    whole m = a->rows, p = a->passive, wide = w->most;
    double before = 2.0 * LONGEST, *normal = w->small, *step = w->right;
    for (int count = 0; count < MOST; count++) {
        double total = 0.0, size = 0.0;
        int shrinks, ends, held;
        place(a, q, loose_joints, 0, h);
        if (!join(a, q, loose_joints, h)) {
            return 0;
        }
        open_gaps(a, h, h->screws + 6 * a->driven, p, h->roots, 0, h->by);
        for (whole i = 0; i < p; i++) {
            step[WIDE * i] = 0.0;
            for (whole r = 0; r < m; r++) {
                step[WIDE * i] += h->by[r * p + i] * h->gaps[r];
            }
            for (whole j = 0; j < p; j++) {
                normal[i * wide + j] = 0.0;
                for (whole r = 0; r < m; r++) {
                    normal[i * wide + j] += h->by[r * p + i] * h->by[r * p + j];
                }
            }
            total += normal[i * wide + i];
        }
        held = positive(normal, p, wide, -NEAR_SINGULAR * total, w->inverse, wide);
        if (!factor(normal, p, wide, w->order)) {
            return 0;
        }
        solve(normal, p, wide, w->order, step, WIDE);
        for (whole i = 0; i < p; i++) {
            size = fmax(size, fabs(step[WIDE * i]));
        }
        if (!(size < HUGE_VAL)) {
            return 0;
        }
        shrinks = size <= 0.5 * before;
        ends = (size <= CLOSED) || ((size <= SQUARED) && shrinks) || ((size <= ROUNDED) && !shrinks);
        if (!ends && !shrinks && !jumps) {
            return 0;
        }
        for (whole i = 0; i < p; i++) {
            loose_joints[i] -= step[WIDE * i] * (ends ? 1.0 : fmin(1.0, LONGEST / size));
        }
        before = size;
        if (ends) {
            double largest = 0.0;
            for (whole r = 0; r < m; r++) {
                largest = fmax(largest, fabs(h->gaps[r]));
            }
            return (largest <= ASSEMBLED) && held;
        }
    }
    return 0;
}

/* Fill the (m, m) projector on what nothing answers to, unless that of the row before holds; return whether the gaps
 * are closed there. With A the rows of the gaps' changes by unit motions, t the trace of A A' and P the projector, all
 * rows are answered to or idle where A A' + t P - 10 ALIGNED^2 t 1 has a Cholesky factor: rounding moves eigenvalues of
 * that by m eps t, 1e-15 t beside the 1e-7 t that is asked for. */
static int find_idle(const arm *a, const here *h, work *w, double *idle, double *reached)
{
    whole m = a->rows, p = a->passive, count = p + h->rank, wide = w->most;
    double total = 0.0, worst = 0.0, *trial = w->small, *ways = reached + m * m, largest = 0.0;
    int some = 0;
    fill(reached, m * m);
    for (whole r = 0; r < m; r++) {
        for (whole s = 0; s <= r; s++) {
            for (whole z = 0; z < count; z++) {
                double part = (z < p) ? 1.0 : 1.0 / dot6(h->roots + 6 * (z - p), h->roots + 6 * (z - p));
                reached[r * m + s] += h->by[r * count + z] * h->by[s * count + z] * part;
            }
        }
        total += reached[r * m + r];
        some |= idle[r * m + r] != 0.0;
    }
    for (whole r = 0; r < m; r++) {
        for (whole z = 0; (z < count) && some; z++) {
            double rest = 0.0, part = (z < p) ? 1.0 : 1.0 / dot6(h->roots + 6 * (z - p), h->roots + 6 * (z - p));
            for (whole s = 0; s < m; s++) {
                rest += idle[r * m + s] * h->by[s * count + z];
            }
            worst = fmax(worst, rest * rest * part);
        }
        for (whole s = 0; s <= r; s++) {
            reached[s * m + r] = reached[r * m + s];
            trial[r * wide + s] = trial[s * wide + r] = reached[r * m + s] + total * idle[r * m + s];
        }
    }
    if (!((worst <= 1e-26 * total) && positive(trial, m, wide, -10.0 * ALIGNED * ALIGNED * total, w->inverse, wide))) {
        eigen(reached, m, ways);
        fill(idle, m * m);
        for (whole c = 0; c < m; c++) {
            largest = fmax(largest, reached[c * m + c]);
        }
        for (whole c = 0; c < m; c++) {
            for (whole r = 0; (r < m) && (reached[c * m + c] <= ALIGNED * ALIGNED * largest); r++) {
                for (whole s = 0; s < m; s++) {
                    idle[r * m + s] += ways[r * m + c] * ways[s * m + c];
                }
            }
        }
    }
    for (whole r = 0; r < m; r++) {
        double rest = 0.0;
        for (whole s = 0; s < m; s++) {
            rest += idle[r * m + s] * h->gaps[s];
        }
        if (!(fabs(rest) <= ALIGNED)) {
            return 0;
        }
    }
    return 1;
}

/* Fill rows of R, and of S in `here`, of laws with R S' = C, whose they are, and whether R is S: whether all are symmetric
 * and nowhere negative. Return the largest number of C. */
static double root(const arm *a, const double *compliance, here *h, double *roots, int *even)
{
    double largest = 0.0, rest[6][6];
    whole rank = 0, first = a->driven + a->passive;
    *even = 1;
    for (whole i = 0; i < 36 * a->flexures; i++) {
        largest = fmax(largest, fabs(compliance[i]));
    }
    for (whole i = 0; i < a->flexures; i++) {
        double odd = 0.0, most = 0.0;
        h->begins[i] = rank;
        for (int r = 0; r < 6; r++) {
            for (int c = 0; c < 6; c++) {
                rest[r][c] = compliance[36 * i + 6 * r + c];
                most = fmax(most, fabs(rest[r][c]));
                odd = fmax(odd, fabs(compliance[36 * i + 6 * c + r] - rest[r][c]));
            }
        }
        *even = *even && (odd <= ROUNDING * largest); /* where a pivot is on the diagonal R is S for even laws alone */
        for (int pass = 0; pass < 6; pass++) {
            int row = 0, column, straight;
            double size, by;
            for (int r = 0; r < 6; r++) {
                row = (rest[r][r] > rest[row][row]) ? r : row;
            }
            column = row;
            if ((odd > ROUNDING * largest) || (rest[row][row] < (1.0 - ROUNDING) * most)) {
                for (int r = 0; r < 6; r++) {
                    for (int c = 0; c < 6; c++) {
                        if (fabs(rest[r][c]) > fabs(rest[row][column])) {
                            row = r;
                            column = c;
                        }
                    }
                }
            }
            size = rest[row][column];
            straight = (row == column) && (size > 0.0);
            most = 0.0;
            if (!(fabs(size) > (straight ? 1e-14 : ROUNDING) * largest)) {
                break;
            }
            *even = *even && straight;
            by = 1.0 / sqrt(fabs(size));
            for (int r = 0; r < 6; r++) {
                roots[6 * rank + r] = by * rest[r][column];
                h->roots[6 * rank + r] = copysign(by, size) * rest[row][r];
            }
            for (int r = 0; r < 6; r++) {
                for (int c = 0; c < 6; c++) {
                    rest[r][c] -= roots[6 * rank + r] * h->roots[6 * rank + c];
                    most = fmax(most, fabs(rest[r][c]));
                }
            }
            h->owner[rank] = i;
            h->carriers[first + rank] = (a->flexure[i] > 0) ? a->flexure[i] : 0;
            fill(h->screws + 6 * (first + rank), 6);
            rank++;
        }
    }
    h->begins[a->flexures] = h->rank = rank;
    return largest;
}

static double tension(const double *tie, whole kind, double length)
{
    if (kind == COIL) {
        return tie[26] + tie[24] * (length - tie[25]);
    }
    return (kind == GAS) ? -tie[24] * pow(tie[25] / length, tie[26]) : 0.0;
}

/* Fill where a wrench acts, and force and moment there; return its element. Those below 0 are weights. */
static whole pushed(const arm *a, const here *h, const double *wrenches, whole j, double *point, double *force, double *moment)
{
    const double *gravity = a->elements + 20 * a->count + 12;
    whole k = (j < 0) ? a->count + j : a->links[3 * j];
    if (j < 0) {
        point_of(h, k, a->elements + 20 * k + 16, point);
        for (int i = 0; i < 3; i++) {
            force[i] = a->elements[20 * k + 15] * gravity[i];
            moment[i] = 0.0;
        }
        return k;
    }
    point_of(h, k, wrenches + 9 * j, point);
    memcpy(force, wrenches + 9 * j + 3, 3 * sizeof *force);
    memcpy(moment, wrenches + 9 * j + 6, 3 * sizeof *moment);
    if (a->links[3 * j + 2] != 0) {
        turned(h->turn + 9 * k, force, force);
        turned(h->turn + 9 * k, moment, moment);
    }
    return k;
}

/* From where it is and `forces`, fill `loads`. */
static void weigh(const arm *a, const double *wrenches, here *h)
{
    fill(h->loads, 6 * a->count);
    for (whole j = -a->count; j < a->pushes; j++) {
        double point[3], force[3], moment[3], lever[3];
        whole k = pushed(a, h, wrenches, j, point, force, moment);
        cross(point, force, lever);
        for (int i = 0; i < 3; i++) {
            h->loads[6 * k + i] += force[i];
            h->loads[6 * k + 3 + i] += moment[i] + lever[i];
        }
    }
    for (whole t = 0; t < a->ties; t++) {
        const whole *j6 = a->joins + 6 * t;
        whole kind = j6[0], end = j6[4];
        if (kind >= COIL) {
            end = j6[3] + 1;
        }
        for (whole r = j6[3]; (r < end) && (kind != GEAR); r++) {
            double by = (kind >= COIL) ? tension(a->tie + 45 * t, kind, h->lengths[t]) : h->forces[r];
            for (int i = 0; i < 6; i++) {
                h->loads[6 * j6[1] + i] += by * h->ways[6 * r + i];
                h->loads[6 * j6[2] + i] -= by * h->ways[6 * r + i];
            }
        }
    }
    for (whole k = a->count - 1; k > 0; k--) {
        for (int i = 0; i < 6; i++) {
            h->loads[6 * a->parents[k] + i] += h->loads[6 * k + i];
        }
    }
}

/* Fill a load in the axes of a frame. */
static void borne(const double *load, const double *turn, const double *at, double *found)
{
    double moment[3];
    cross(load, at, moment);
    for (int i = 0; i < 3; i++) {
        moment[i] += load[3 + i];
    }
    turned_back(turn, load, found);
    turned_back(turn, moment, found + 3);
}

static void bear(const arm *a, here *h)
{
    for (whole i = 0; i < a->flexures; i++) {
        whole k = a->flexure[i];
        double *load = h->load + 6 * i;
        if (k >= 0) {
            borne(h->loads + 6 * k, h->turn + 9 * k, h->origin + 3 * k, load);
            continue;
        }
        fill(load, 6);
        for (whole r = a->joins[6 * (-1 - k) + 3]; r < a->joins[6 * (-1 - k) + 4]; r++) {
            for (int b = 0; b < 6; b++) {
                load[b] += h->forces[r] * a->row[6 * r + b];
            }
        }
    }
}

/* Take away by how much the load on what a coordinate carries turns with it, at some rates. */
static inline void turn_back(const here *h, whole z, pack rates, double *field, whole wide)
{
    const double *load = h->loads + 6 * h->carriers[z], *s = h->screws + 6 * z;
    double one[3], two[3], three[3];
    cross(load, s + 3, one);
    cross(load + 3, s + 3, two);
    cross(load, s, three);
    for (int i = 0; i < 3; i++) {
        two[i] += three[i];
    }
    add_columns(field, wide, share(rates, spread3(one)));
    add_columns(field + 3 * wide, wide, share(rates, spread3(two)));
}

/* Add what the change of a tie's wrench gives at its ends, and the change of its gaps. */
static void tied(const arm *a, const here *h, whole t, const double *forces, const double *motion, double *one, double *two, whole wide)
{
    const whole *j6 = a->joins + 6 * t;
    whole kind = j6[0], e1 = j6[1], e2 = j6[2], start = j6[3], end = j6[4];
    const double *tie = a->tie + 45 * t, *pairs = h->pairs + 18 * t, *along = h->ways + 6 * start;
    double p1[3], p2[3], pull[3] = {0.0}, about[3] = {0.0}, moment[3] = {0.0}, across = 0.0, rate = 0.0;
    point_of(h, e1, tie, p1);
    point_of(h, e2, tie + 3, p2);
    if (kind >= ROD) {
        double tense = (kind == ROD) ? h->forces[start] : tension(tie, kind, h->lengths[t]);
        across = tense / h->lengths[t];
        rate = (kind == COIL) ? tie[24] : (kind == GAS) ? -tie[26] * across : 0.0;
        for (int i = 0; i < 3; i++) {
            pull[i] = tense * along[i];
        }
    } else {
        for (whole r = start; r < end; r++) {
            for (int i = 0; i < 3; i++) {
                pull[i] += h->forces[r] * a->way[6 * r + i];
                about[i] += h->forces[r] * a->way[6 * r + 3 + i];
            }
        }
        turned(h->turn + 9 * e1, pull, pull);
        turned(h->turn + 9 * e1, about, about);
        for (whole j = 0; j < kind; j++) {
            double back[3];
            cross(about, pairs + 3 * j, back);
            cross(pairs + 9 + 3 * j, back, back);
            for (int i = 0; i < 3; i++) {
                moment[i] += back[i];
            }
        }
    }
    for (whole b = 0; b < wide; b += WIDE) {
        const double *m1 = motion + e1 * 6 * wide + b, *m2 = motion + e2 * 6 * wide + b;
        packs turn = less(columns(m2 + 3 * wide, wide), columns(m1 + 3 * wide, wide));
        packs shift = less(columns(m2, wide), columns(m1, wide)), change = crossed(spread3(pull), turn);
        shift = sum(shift, crossed(turn, spread3(p2)));
        if (kind >= ROD) {
            pack stretch = scale(rate - across, add(add(scale(along[0], shift.x), scale(along[1], shift.y)), scale(along[2], shift.z)));
            packs push = sum(share(spread(across), shift), share(stretch, spread3(along)));
            change = sum(change, push);
            add_columns(one + b, wide, share(spread(-1.0), push));
            add_columns(one + b + 3 * wide, wide, crossed(push, spread3(p1)));
            add_columns(two + b + 3 * wide, wide, crossed(spread3(p2), change));
        } else {
            packs other = crossed(spread3(p2), change), back = sum(crossed(spread3(pull), shift), crossed(spread3(moment), turn));
            for (whole j = 0; j < kind; j++) {
                double way[3];
                packs held;
                cross(about, pairs + 3 * j, way);
                held = crossed(spread3(pairs + 9 + 3 * j), crossed(spread3(way), turn));
                other = sum(other, held);
                back = less(back, held);
            }
            add_columns(one + b + 3 * wide, wide, back);
            add_columns(two + b + 3 * wide, wide, other);
        }
        add_columns(two + b, wide, change);
    }
    for (whole r = start; (r < end) && (forces != NULL); r++) {
        for (int i = 0; i < 6; i++) {
            for (whole b = 0; b < wide; b += WIDE) {
                pack by = scale(h->ways[6 * r + i], get(forces + r * wide + b));
                put(one + i * wide + b, sub(get(one + i * wide + b), by));
                put(two + i * wide + b, add(get(two + i * wide + b), by));
            }
        }
    }
}

/* Add by how much what acts on each element changes as the elements move; their motions are `step` apart. */
static void push_back(const arm *a, const here *h, const double *wrenches, const double *changes, whole wide,
                      const double *motion, whole step, double *field)
{
    for (whole j = -a->count; j < a->pushes; j++) {
        const double *moved;
        double point[3], force[3], moment[3], lever[3], *own;
        whole k = pushed(a, h, wrenches, j, point, force, moment);
        int follows = (j >= 0) && (a->links[3 * j + 2] != 0);
        own = field + k * 6 * wide;
        moved = motion + k * step;
        cross(point, force, lever);
        for (int i = 0; i < 3; i++) {
            moment[i] += lever[i];
        }
        for (whole b = 0; (b < wide) && (follows || (dot(force, force) > 0.0)); b += WIDE) {
            packs about = columns(moved + b + 3 * wide, wide), change = crossed(about, spread3(force));
            add_columns(own + b, wide, change);
            if (follows) {
                packs turning = sum(crossed(about, spread3(moment)), crossed(columns(moved + b, wide), spread3(force)));
                add_columns(own + b + 3 * wide, wide, turning);
            } else {
                add_columns(own + b + 3 * wide, wide, crossed(spread3(point), change));
            }
        }
        for (whole b = 0; (b < wide) && (changes != NULL) && (j >= 0); b += WIDE) {
            const double *c = changes + 36 * j;
            packs about = columns(moved + b + 3 * wide, wide);
            packs way = sum(columns(moved + b, wide), crossed(about, spread3(point)));
            packs push = sum(back_turned(c, 6, way), back_turned(c + 18, 6, about));
            packs twist = sum(back_turned(c + 3, 6, way), back_turned(c + 21, 6, about));
            add_columns(own + b, wide, share(spread(-1.0), push));
            add_columns(own + b + 3 * wide, wide, share(spread(-1.0), sum(twist, crossed(spread3(point), push))));
        }
    }
}

/* Fill (k, 6 W) motions of elements, and work per twist that is inserted at one and moves all that it carries. */
static void spread_out(const arm *a, const here *h, const double *wrenches, const double *changes, const double *rows,
                       whole count, whole wide, const double *forces, double *motion, double *field)
{
    fill(motion, a->count * 6 * wide);
    fill(field, a->count * 6 * wide);
    for (whole z = 0; z < count; z++) {
        whole k = h->carriers[a->driven + z];
        const double *s = h->screws + 6 * (a->driven + z), *row = rows + z * wide;
        for (whole b = 0; (b < wide) && (k > 0); b += WIDE) {
            if ((row[b] != 0.0) || (row[b + 1] != 0.0) || (row[b + 2] != 0.0) || (row[b + 3] != 0.0)) {
                pack rates = get(row + b);
                add_columns(motion + k * 6 * wide + b, wide, share(rates, spread3(s)));
                add_columns(motion + k * 6 * wide + b + 3 * wide, wide, share(rates, spread3(s + 3)));
                turn_back(h, a->driven + z, rates, field + k * 6 * wide + b, wide);
            }
        }
    }
    for (whole k = 1; k < a->count; k++) {
        double *own = motion + k * 6 * wide, *back = motion + a->parents[k] * 6 * wide;
        for (whole b = 0; b < 6 * wide; b += WIDE) {
            put(own + b, add(get(own + b), get(back + b)));
        }
    }
    push_back(a, h, wrenches, changes, wide, motion, 6 * wide, field);
    for (whole t = 0; t < a->ties; t++) {
        const whole *j6 = a->joins + 6 * t;
        if (j6[0] != GEAR) {
            tied(a, h, t, forces, motion, field + j6[1] * 6 * wide, field + j6[2] * 6 * wide, wide);
        }
    }
    for (whole k = a->count - 1; k > 0; k--) {
        double *own = field + k * 6 * wide, *back = field + a->parents[k] * 6 * wide;
        for (whole b = 0; b < 6 * wide; b += WIDE) {
            put(back + b, add(get(back + b), get(own + b)));
        }
    }
}

/* A pack of columns of the product of some numbers with rows of a width. */
static inline pack sum_of(const double *shares, const double *rows, whole wide, whole count)
{
    pack value = scale(shares[0], get(rows));
    for (whole r = 1; r < count; r++) {
        value = add(value, scale(shares[r], get(rows + r * wide)));
    }
    return value;
}

/* Add rows of numbers times rows of TIP or BOTH to some rows; numbers are `down` and `next` apart. */
static inline void add_product(whole high, double sign, const double *left_, whole down, whole next, const double *rows,
                               whole width, whole count, double *to, whole step, whole wide)
{
    for (whole b = 0; b < high; b++) {
        double *own = to + step * b;
        pack one = get(own), two = get(own + WIDE), three = (wide > TIP) ? get(own + TIP) : one;
        for (whole i = 0; i < count; i++) {
            pack by = spread(sign * left_[down * b + next * i]);
            one = add(one, mul(by, get(rows + width * i)));
            two = add(two, mul(by, get(rows + width * i + WIDE)));
            if (wide > TIP) {
                three = add(three, mul(by, get(rows + width * i + TIP)));
            }
        }
        put(own, one);
        put(own + WIDE, two);
        if (wide > TIP) {
            put(own + TIP, three);
        }
    }
}

/* Fill `stiff`: what motions of coordinates change of the loads, a row for each of (Z, 6) motions that are met. */
static void stiffen(const arm *a, const here *h, work *w, const double *wrenches, const double *changes, const double *met)
{
    spread_out(a, h, wrenches, changes, w->unit, w->total, w->wide, NULL, w->motion, w->field);
    for (whole z = 0; z < w->total; z++) {
        const double *field = w->field + h->carriers[a->driven + z] * 6 * w->wide;
        for (whole b = 0; b < w->wide; b += WIDE) {
            put(w->stiff + z * w->wide + b, sum_of(met + 6 * z, field + b, w->wide, 6));
        }
    }
}

/* Fill and factor the matrix, forces by `unit`; `by` is what moves, as rows. */
static int system_of(const arm *a, const here *h, work *w, const double *idle, double unit, const double *by)
{
    whole free_ = w->total, m = a->rows, side = w->side, rank = h->rank;
    for (whole i = 0; i < free_; i++) {
        for (whole j = 0; j < free_; j++) {
            w->matrix[i * side + j] = w->stiff[i * w->wide + j];
        }
        w->matrix[i * side + i] += (i >= free_ - rank) ? 1.0 : 0.0;
        for (whole r = 0; r < m; r++) {
            w->matrix[i * side + free_ + r] = unit * by[r * free_ + i];
            w->matrix[(free_ + r) * side + i] = unit * h->by[r * free_ + i];
        }
    }
    for (whole r = 0; r < m; r++) {
        for (whole s = 0; s < m; s++) {
            w->matrix[(free_ + r) * side + free_ + s] = -unit * unit * idle[s * m + r];
        }
    }
    return factor(w->matrix, free_ + m, side, w->order);
}

/* A bound on how negative G or Z' G Z is: below 1 is a proof that the arm stays. */
static double proof(const double *stiff, whole n, whole wide, double *lower, whole width)
{
    double norm = 0.0, shares[2] = {SHARE, 1.0 - 1e-9};
    for (whole r = 0; r < n; r++) {
        for (whole c = 0; c < n; c++) {
            norm += stiff[r * wide + c] * stiff[r * wide + c];
        }
    }
    norm = sqrt(norm);
    for (int i = 0; i < 2; i++) {
        if ((norm > shares[i]) && positive(stiff, n, wide, shares[i], lower, width)) {
            norm = shares[i];
        }
    }
    return norm;
}

/* Fill `stiff`, and return the bound on the loads' share of the tangent; `matrix` is M still, that without G. With Z the
 * columns of M^-1 that laws take it is Z' G Z where they are even, else the rows of flexures of M^-1 G Z: its eigenvalues
 * are those of the tangent less 1 but for zeros. */
static double distance_of(const arm *a, const here *h, work *w, const double *wrenches, const double *met, int even)
{
    whole total = w->total, rank = h->rank, p = total - rank, wide = wide_of(rank), size = total + a->rows;
    double *half = w->small, *form = w->inverse;
    fill(w->laws, size * wide);
    for (whole c = 0; c < rank; c++) {
        w->laws[(p + c) * wide + c] = 1.0;
    }
    solve(w->matrix, size, w->side, w->order, w->laws, wide);
    stiffen(a, h, w, wrenches, NULL, met);
    for (whole b = 0; b < wide; b += WIDE) {
        for (whole z = 0; z < total; z++) {
            put(half + z * w->most + b, sum_of(w->stiff + z * w->wide, w->laws + b, wide, total));
        }
    }
    if (even) {
        for (whole b = 0; b < wide; b += WIDE) {
            for (whole c = 0; c < rank; c++) {
                pack value = scale(w->laws[c], get(half + b));
                for (whole z = 1; z < total; z++) {
                    value = add(value, scale(w->laws[z * wide + c], get(half + z * w->most + b)));
                }
                put(form + c * w->most + b, value);
            }
        }
        return proof(form, rank, w->most, half, w->most);
    }
    fill(w->laws + total * wide, a->rows * wide);
    for (whole b = 0; b < wide; b += WIDE) {
        for (whole z = 0; z < total; z++) {
            put(w->laws + z * wide + b, get(half + z * w->most + b));
        }
    }
    solve(w->matrix, size, w->side, w->order, w->laws, wide);
    for (whole c = 0; c < rank; c++) {
        memcpy(form + c * w->most, w->laws + (p + c) * wide, (size_t)wide * sizeof *form);
    }
    return proof(form, rank, w->most, half, w->most);
}

/* Twists along which loads are asked, and the change of the gaps by them: those of what moves where laws are even. */
typedef struct {
    const double *roots; /* rows of S */
    double *met, *by;
} rows_of;

static void ask_along(const arm *a, const here *h, const rows_of *f, int bridged)
{
    whole p = a->passive, total = p + h->rank;
    memcpy(f->met, h->screws + 6 * a->driven, (size_t)(6 * total) * sizeof *f->met);
    place_laws(a, h, f->roots, f->met + 6 * p);
    if (bridged) {
        open_gaps(a, h, f->met, total, f->roots, h->rank, f->by);
    }
}

/* From where the loops are closed, with `by` there, move to rest; return by how much loads change the stiffness. */
static double settle(const arm *a, const double *compliance, const double *offset, double unit, const double *wrenches,
                     const double *q, double *loose_joints, const double *idle, const rows_of *odd, here *h, work *w)
{
    whole p = a->passive, m = a->rows, rank = h->rank, total = p + rank, gears = m, n = a->flexures;
    double before = HUGE_VAL, distance = HUGE_VAL, rate = 0.0, *right = w->right;
    const double *met = odd ? odd->met : h->screws + 6 * a->driven, *by = odd ? odd->by : h->by;
    int given = 0;
    fill(h->forces, m);
    fill(h->y, 6 * n);
    fill(w->stiff, w->total * w->wide);
    for (whole t = 0; t < a->ties; t++) {
        gears -= a->joins[6 * t] == GEAR;
    }
    for (whole i = 0; i < 6 * n; i++) {
        h->twists[i] = offset[i];
        given |= offset[i] != 0.0;
    }
    for (int count = 0; count < STEPS; count++) {
        double size = 0.0, square = 0.0;
        if ((count > 0) || given) {
            place(a, q, loose_joints, 1, h);
            place_laws(a, h, h->roots, h->screws + 6 * (a->driven + p));
            if (!join(a, q, loose_joints, h)) {
                return HUGE_VAL;
            }
            if (count < 2) {
                open_gaps(a, h, h->screws + 6 * a->driven, total, h->roots, rank, h->by);
            }
        }
        if (odd) {
            ask_along(a, h, odd, count < 2);
        }
        weigh(a, wrenches, h);
        if (count == 1) {
            distance = distance_of(a, h, w, wrenches, met, odd == NULL);
            if (!(distance <= SHARE)) {
                return HUGE_VAL;
            }
        }
        if ((count < 2) && !system_of(a, h, w, idle, unit, by)) {
            return HUGE_VAL;
        }
        for (whole z = 0; z < total; z++) {
            whole k = h->carriers[a->driven + z];
            double value = dot6(met + 6 * z, h->loads + 6 * k) - ((z >= p) ? h->y[z - p] : 0.0);
            for (whole r = (k > 0) ? gears : 0; r < m; r++) {
                value -= by[r * total + z] * h->forces[r];
            }
            right[WIDE * z] = value;
        }
        for (whole r = 0; r < m; r++) {
            right[WIDE * (total + r)] = -unit * h->gaps[r];
            for (whole s = 0; s < m; s++) {
                right[WIDE * (total + r)] += unit * idle[r * m + s] * h->forces[s];
            }
        }
        solve(w->matrix, total + m, w->side, w->order, right, WIDE);
        for (whole z = 0; z < p; z++) {
            loose_joints[z] += right[WIDE * z];
            size += right[WIDE * z] * right[WIDE * z];
        }
        for (whole r = 0; r < m; r++) {
            h->forces[r] += unit * right[WIDE * (total + r)];
        }
        for (whole c = 0; c < rank; c++) {
            double step = right[WIDE * (p + c)], *own = h->roots + 6 * c;
            whole i = h->owner[c];
            h->y[c] += step;
            size += (a->flexure[i] >= 0) ? step * step * dot6(own, own) : 0.0;
            for (int b = 0; b < 6; b++) {
                h->twists[6 * i + b] += own[b] * step;
            }
        }
        for (whole i = 0; i < n; i++) {
            square += (a->flexure[i] >= 0) ? dot6(h->twists + 6 * i, h->twists + 6 * i) : 0.0;
        }
        if (!(size < HUGE_VAL) || ((count > 1) && !(size < SLOWEST * before) && (size > CONVERGED))) {
            return HUGE_VAL;
        }
        /* The matrix stays that of the second step, so what it is off by is twice that step's curvature: one that
         * happened to be short promises nothing. Squares, as sizes are. */
        rate = (count == 1) ? fmin(16.0 * (size / before) * (size / before), SLOWEST) : fmax(rate, size / before);
        if ((count > 1) && (size * rate <= ENDS)) {
            if (size > ENDS) {
                place(a, q, loose_joints, 1, h);
                (void)join(a, q, loose_joints, h);
            }
            weigh(a, wrenches, h);
            bear(a, h);
            for (whole i = 0; i < n; i++) {
                for (int b = 0; (b < 6) && (a->flexure[i] < 0); b++) {
                    h->twists[6 * i + b] = offset[6 * i + b] + dot6(compliance + 36 * i + 6 * b, h->load + 6 * i);
                }
            }
            for (whole r = 0; r < m; r++) {
                if (!(fabs(h->gaps[r]) <= ALIGNED)) {
                    return HUGE_VAL;
                }
            }
            return (square < SMALL) ? distance : HUGE_VAL;
        }
        before = size;
    }
    return HUGE_VAL;
}

/* ---- Answers ---------------------------------------------------------------------------------------------------- */

/* Fill the product of a pose and a frame's. */
static void compose(const double *turn, const double *origin, const double *frame, double *into, double *at)
{
    for (int i = 0; i < 3; i++) {
        at[i] = origin[i] + dot(turn + 3 * i, frame + 9);
        turned_back(frame, turn + 3 * i, into + 3 * i);
    }
}

static void pose(const double *turn, const double *at, double *into)
{
    for (int i = 0; i < 3; i++) {
        memcpy(into + 4 * i, turn + 3 * i, 3 * sizeof *into);
        into[4 * i + 3] = at[i];
        into[12 + i] = 0.0;
    }
    into[15] = 1.0;
}

static void frame_at(const here *h, const double *end, double *turn, double *at)
{
    whole k = (whole)end[15];
    compose(h->turn + 9 * k, h->origin + 3 * k, end, turn, at);
}

/* Fill the (6, 6) body motion per change of a twist. */
static void right_jacobian(const double *twist, double *found)
{
    double s = dot(twist + 3, twist + 3), d = dot(twist, twist + 3);
    double one = 0.0, two = 0.0, three = 0.0, four = 0.0, slope = 0.0, power = 1.0, term = 1.0, across, square, same, far;
    for (int j = 0; j < 14; j++) {
        term /= 2 * j + 2;
        one -= term * power;
        three += term * slope;
        term /= 2 * j + 3;
        two += term * power;
        four -= term * slope;
        slope = (j + 1) * power;
        power *= -s;
    }
    across = 2.0 * d * three;
    square = 2.0 * d * four;
    same = 1.0 - s * two;
    far = -2.0 * d * two - s * square;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double a = twist[3 + i], b = twist[3 + j];
            found[6 * (3 + i) + j] = 0.0;
            found[6 * i + j] = two * a * b;
            found[6 * i + 3 + j] = two * (a * twist[j] + twist[i] * b) + square * a * b;
        }
        found[6 * i + i] += same;
        found[6 * i + 3 + i] += far;
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double turns = one * twist[3 + k], moves = one * twist[k] + across * twist[3 + k];
        found[6 * i + j] -= turns;
        found[6 * j + i] += turns;
        found[6 * i + 3 + j] -= moves;
        found[6 * j + 3 + i] += moves;
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            found[6 * (3 + i) + 3 + j] = found[6 * i + j];
        }
    }
}

/* Fill the rotation vector of a rotation by less than a half turn. */
static void logarithm(const double *t, double *found)
{
    double v[3] = {0.5 * (t[7] - t[5]), 0.5 * (t[2] - t[6]), 0.5 * (t[3] - t[1])}, sine = sqrt(dot(v, v)), by = 1.0;
    if (sine > 1e-8) {
        by = atan2(sine, 0.5 * (t[0] + t[4] + t[8] - 1.0)) / sine;
    }
    for (int i = 0; i < 3; i++) {
        found[i] = by * v[i];
    }
}

static whole rest_rows(const arm *a, whole rows, const double *q, whole settled, whole first, double *free_joints,
                       double *idle, const rested *f, double *room)
{
    whole p = a->passive, m = a->rows, n = a->flexures, d = a->driven, rank = -1;
    here h = memory(a, &room);
    double unit = 0.0, *roots = take(&room, 36 * n), *reached = take(&room, 2 * m * m), *rest;
    rows_of odd = {roots, take(&room, 6 * (p + 6 * n)), take(&room, m * (p + 6 * n))};
    work closing = divided(a, p, 0, &room), w = closing;
    int even = 0;
    for (whole row = first; row < rows; row++) {
        const double *here_q = q + row * d, *pushing = a->wrenches + 9 * a->pushes * ((row < a->wrench_rows) ? row : a->wrench_rows - 1);
        whole own = (row < a->law_rows) ? row : a->law_rows - 1;
        const double *compliance = a->compliance + 36 * n * own, *offset = a->offset + 6 * n * own;
        double turn[9], at[3], moved[9], end[3], change[9];
        fill(h.twists, 6 * n);
        if (!close_loops(a, here_q, 0, free_joints, &h, &closing)) {
            return row;
        }
        memcpy(f->closed + row * p, free_joints, (size_t)p * sizeof *free_joints);
        if (settled && ((row == first) || (own > 0))) {
            unit = 1.0 / sqrt(fmax(root(a, compliance, &h, roots, &even), 1e-9));
            rest = h.roots;
            h.roots = roots; /* R moves, and S is met */
            odd.roots = roots = rest;
            if (rank != h.rank) {
                rank = h.rank;
                rest = room;
                w = divided(a, p, rank, &rest);
            }
        }
        place(a, here_q, free_joints, 0, &h);
        frame_at(&h, a->elements + 20 * a->count, turn, at);
        pose(turn, at, f->tips + 16 * row);
        if (!settled) {
            continue;
        }
        place_laws(a, &h, h.roots, h.screws + 6 * (d + p));
        (void)join(a, here_q, free_joints, &h);
        open_gaps(a, &h, h.screws + 6 * d, w.total, h.roots, h.rank, h.by);
        if (!find_idle(a, &h, &closing, idle, reached)) {
            return row;
        }
        memcpy(f->flexed + row * p, free_joints, (size_t)p * sizeof *free_joints);
        f->distance[row] = settle(a, compliance, offset, unit, pushing, here_q, f->flexed + row * p, idle,
                                  even ? NULL : &odd, &h, &w);
        if (!(f->distance[row] <= SHARE)) {
            return row;
        }
        memcpy(f->twists + row * 6 * n, h.twists, (size_t)(6 * n) * sizeof *h.twists);
        memcpy(f->loads + row * 6 * n, h.load, (size_t)(6 * n) * sizeof *h.load);
        memcpy(f->forces + row * m, h.forces, (size_t)m * sizeof *h.forces);
        memcpy(f->idles + row * m * m, idle, (size_t)(m * m) * sizeof *idle);
        frame_at(&h, a->elements + 20 * a->count, moved, end);
        for (int i = 0; i < 3; i++) {
            f->displacement[6 * row + i] = end[i] - at[i];
            turned(turn, moved + 3 * i, change + 3 * i);
        }
        if (f->ends != NULL) {
            pose(moved, end, f->ends + 16 * row);
        }
        logarithm(change, f->displacement + 6 * row + 3);
    }
    return rows;
}

/* Fill the answers of a field to twists in the axes of a frame, a row for each. */
static void turn_in(const double *field, const double *turn, const double *at, double sign, double *found)
{
    for (int b = 0; b < TIP; b += WIDE) {
        packs force = columns(field + b, TIP), moment = columns(field + b + 3 * TIP, TIP);
        moment = back_turned(turn, 3, sum(moment, crossed(force, spread3(at))));
        force = back_turned(turn, 3, force);
        put_columns(found + b, TIP, share(spread(sign), force));
        put_columns(found + b + 3 * TIP, TIP, share(spread(sign), moment));
    }
}

/* Fill six rows of six from rows of TIP as columns; rows are `stride` apart. */
static inline void transpose(const double *rows, double *out, whole stride)
{
    for (int b = 0; b < 6; b++) {
        for (int i = 0; i < 6; i++) {
            out[b * stride + i] = rows[i * TIP + b];
        }
    }
}

static void answer(const double *field, const double *turn, const double *at, double sign, double *out, whole stride)
{
    double solved[6 * TIP];
    turn_in(field, turn, at, sign, solved);
    transpose(solved, out, stride);
}

/* Add the (6, 6) answers to a closure's twist. */
static void slots(const arm *a, whole t, const double *force, double *out, whole stride)
{
    for (whole r = a->joins[6 * t + 3]; r < a->joins[6 * t + 4]; r++) {
        for (int b = 0; b < 6; b++) {
            for (int c = 0; c < 6; c++) {
                out[b * stride + c] += force[r * TIP + b] * a->row[6 * r + c];
            }
        }
    }
}

#if !defined(CONTROLLER)
/* Add some rows of the tangent of a flexure's neurons under a load. */
static void steepen(const arm *a, whole i, const double *load, int first, double *total)
{
    neural at[6], by[3][6];
    for (int b = 0; b < 6; b++) {
        at[b] = given(load[b]);
        by[0][b] = by[1][b] = by[2][b] = given(0.0);
    }
    for (const double *u = a->neurons + 52 * a->starts[i]; u < a->neurons + 52 * a->starts[i + 1]; u += 52) {
        for (int j = 0; j < WIDE; j += EACH) {
            neural units[6], value = weight(u + 24 + j), slope;
            for (int b = 0; b < 6; b++) {
                units[b] = weight(u + 4 * b + j);
                value += units[b] * at[b];
            }
            value = N(bounded)(value);
            slope = 1.0 - value * value;
            for (int b = 0; b < 3; b++) {
                neural gain = slope * weight(u + 28 + 4 * (first + b) + j);
                for (int c = 0; c < 6; c++) {
                    by[b][c] += gain * units[c];
                }
            }
        }
    }
    for (int b = 0; b < 3; b++) {
        for (int c = 0; c < 6; c++) {
            total[TIP * (first + b) + c] += gathered(by[b][c]);
        }
    }
}

/* Fill the tangents of the laws under loads on the flexures. */
static void tangents_at(const arm *a, const double *compliance, const double *weights, const double *loads, double *tangents)
{
    for (whole i = 0; i < a->flexures; i++) {
        const double *load = loads + 6 * i;
        double total[6 * TIP] = {0.0};
        for (int b = 0; b < 6; b++) {
            memcpy(total + TIP * b, compliance + 36 * i + 6 * b, 6 * sizeof *total);
        }
        for (int half = 0; (half < 6) && (a->starts[i] < a->starts[i + 1]); half += 3) {
            steepen(a, i, load, half, total);
        }
        for (whole t = a->spans[i]; t < a->spans[i + 1]; t++) {
            const double *bent = a->bent + 43 * t;
            double value[6], slope[36];
            for (int b = 0; b < 6; b++) {
                value[b] = bent[36 + b] + ((bent[42] > 0.0) ? dot6(bent + 6 * b, load) : 0.0);
            }
            for (int b = 0; b < 36; b++) {
                slope[b] = (bent[42] > 0.0) ? bent[b] : 0.0;
            }
            for (whole f = a->pieces[t]; f < a->pieces[t + 1]; f++) {
                const double *shape = a->shapes + 45 * f;
                double number, by[6];
                if (shape[0] == RAISED) {
                    double base = shape[1], steep;
                    for (int b = 0; b < 6; b++) {
                        by[b] = dot6(shape + 9 + 6 * b, load);
                        base += load[b] * by[b];
                        for (int c = 0; c < 6; c++) {
                            by[b] += load[c] * shape[9 + 6 * c + b];
                        }
                    }
                    base = fmax(base, LEAST);
                    number = pow(base, shape[2]);
                    steep = (base > LEAST) ? shape[2] * pow(base, shape[2] - 1.0) : 0.0;
                    for (int b = 0; b < 6; b++) {
                        by[b] *= steep;
                    }
                } else {
                    double part = shape[1] + dot6(shape + 3, load), steep = 1.0;
                    number = part;
                    if (shape[0] == TANH) {
                        number = bounded_one(part);
                        steep = 1.0 - number * number;
                    } else if (shape[0] == SIZE) {
                        number = fabs(part);
                        steep = (part > 0.0) ? 1.0 : (part < 0.0) ? -1.0 : 0.0;
                    } else if (shape[0] == CLIPPED) {
                        number = fmin(fmax(part, -1.0), 1.0);
                        steep = (fabs(part) < 1.0) ? 1.0 : 0.0;
                    } else if (shape[0] == RAMP) {
                        number = fmax(part, 0.0);
                        steep = (part > 0.0) ? 1.0 : 0.0;
                    }
                    for (int b = 0; b < 6; b++) {
                        by[b] = steep * shape[3 + b];
                    }
                }
                for (int b = 0; b < 6; b++) {
                    for (int c = 0; c < 6; c++) {
                        slope[6 * b + c] = number * slope[6 * b + c] + value[b] * by[c];
                    }
                    value[b] *= number;
                }
            }
            for (int b = 0; b < 36; b++) {
                total[b / 6 * TIP + b % 6] += weights[t] * slope[b];
            }
        }
        for (int b = 0; b < 6; b++) {
            memcpy(tangents + 36 * i + 6 * b, total + TIP * b, 6 * sizeof *total);
        }
    }
}

/* ---- Trees without ties ------------------------------------------------------------------------------------------
 *
 * From the ends to the root: an element answers to its motion v by L - D v, with L of the frame that is asked about, and
 * passes both on to the element inboard. The coordinates of a flexure, of motions S that are met along R, are
 *
 *     dz = N^-1 R'(L - D v)    with N = 1 + R'X, X what the load changes by S alone
 *
 * so that what is inboard of it sees L - X N^-1 R'L and D - X N^-1 R'D. From the root outwards follow motions and fields. */

typedef struct {
    double *moves, *meets;  /* (n, 6 TIP) columns of S and of R, the flexure's axes */
    double *across, *met;   /* (n, 6 TIP) the same about the base's origin, where it is flexed; R by exp6's derivative */
    double *answers;        /* (k, 6 BOTH) D and L beside each other */
    double *systems, *sums; /* (n, 6 SOLVED) N and R'D and R'L beside each other, (n, 3, 6 TIP) see norm_of */
} branches;

static branches branched_off(const arm *a, double **room)
{
    branches t;
    whole n = a->flexures;
    t.moves = zeroed(room, 6 * TIP * n);
    t.meets = zeroed(room, 6 * TIP * n);
    t.across = take(room, 6 * TIP * n);
    t.met = take(room, 6 * TIP * n);
    t.answers = zeroed(room, 6 * BOTH * a->count + WIDE); /* packs of its last row end behind it */
    t.systems = zeroed(room, 6 * SOLVED * n + WIDE);
    t.sums = take(room, 18 * TIP * n);
    return t;
}

/* Keep S and R of the laws: those of `root`, or without these the unit matrix and the laws themselves. */
static void keep_laws(const arm *a, here *h, const double *laws, const double *roots, const branches *t)
{
    for (whole i = 0; i < a->flexures; i++) {
        double *moves = t->moves + 6 * TIP * i, *meets = t->meets + 6 * TIP * i;
        fill(moves, 6 * TIP);
        fill(meets, 6 * TIP);
        for (int b = 0; (b < 6) && (roots == NULL); b++) {
            moves[TIP * b + b] = 1.0;
            memcpy(meets + TIP * b, laws + 36 * i + 6 * b, 6 * sizeof *meets);
            h->begins[i + 1] = 6 * (i + 1);
        }
        for (whole z = h->begins[i]; (z < h->begins[i + 1]) && (roots != NULL); z++) {
            for (int b = 0; b < 6; b++) {
                moves[TIP * b + z - h->begins[i]] = h->roots[6 * z + b];
                meets[TIP * b + z - h->begins[i]] = roots[6 * z + b];
            }
        }
    }
}

/* Fill columns of twists in a flexure's axes as they are about the base's origin. */
static void lift(const here *h, whole k, const double *own, double *lifted)
{
    const double *r = h->turn + 9 * k, back[9] = {r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]};
    for (int b = 0; b < TIP; b += WIDE) {
        packs linear = back_turned(back, 3, columns(own + b, TIP)), angular = back_turned(back, 3, columns(own + b + 3 * TIP, TIP));
        linear = sum(linear, crossed(spread3(h->origin + 3 * k), angular));
        put_columns(lifted + b, TIP, linear);
        put_columns(lifted + b + 3 * TIP, TIP, angular);
    }
}

/* Fill what motions S of a flexure change of the load on what it carries, where that answers by D to all; see turn_back. */
static void move_flexure(const double *load, const double *across, const double *stiff, whole step, double *moved)
{
    for (int b = 0; b < TIP; b += WIDE) {
        packs linear = columns(across + b, TIP), angular = columns(across + b + 3 * TIP, TIP);
        packs pull = crossed(spread3(load), angular), turn = sum(crossed(spread3(load + 3), angular), crossed(spread3(load), linear));
        put_columns(moved + b, TIP, pull);
        put_columns(moved + b + 3 * TIP, TIP, turn);
    }
    add_product(6, 1.0, stiff, step, 1, across, TIP, 6, moved, TIP, TIP);
}

/* Add up the squares that a form makes of columns. */
static double squares(const double *form, const double *of)
{
    double by[6 * TIP] = {0.0}, total = 0.0;
    add_product(6, 1.0, form, TIP, 1, of, TIP, 6, by, TIP, TIP);
    for (int b = 0; b < 6 * TIP; b++) {
        total += by[b] * of[b];
    }
    return total;
}

static void add_squares(const double *rows, double *form)
{
    for (int b = 0; b < 6; b++) {
        for (int c = 0; c < 6; c++) {
            form[TIP * b + c] += dot(rows + TIP * b, rows + TIP * c) + dot(rows + TIP * b + 3, rows + TIP * c + 3);
        }
    }
}

/* The norm of G, from the D of each element by itself: coordinates change what is met inboard of them by R'X, outboard by
 * R'K S with K of all that is outboard. `sums` of a flexure are K, and of all outboard X X' and K'R R'K. */
static double norm_of(const arm *a, const here *h, const branches *t)
{
    double square = 0.0;
    fill(t->sums, 18 * TIP * a->flexures);
    for (whole k = a->count - 1; k > 0; k--) {
        const double *each = t->answers + 6 * BOTH * k;
        whole inboard = a->parents[k], i = a->kinds[a->count + k];
        int gives = (a->kinds[k] & 3) == FLEXURE;
        double *own = gives ? t->sums + 18 * TIP * i : NULL, *to;
        if (gives) {
            const double *across = t->across + 6 * TIP * i, *met = t->met + 6 * TIP * i;
            double moved[6 * TIP], meeting[6 * TIP] = {0.0};
            for (int b = 0; b < 36; b++) {
                own[TIP * (b / 6) + b % 6] += each[BOTH * (b / 6) + b % 6];
            }
            move_flexure(h->loads + 6 * k, across, own, TIP, moved);
            add_product(6, 1.0, own, 1, TIP, met, TIP, 6, meeting, TIP, TIP);
            square += squares(own + 12 * TIP, across);
            add_squares(moved, own + 6 * TIP);
            add_squares(meeting, own + 12 * TIP);
            square += squares(own + 6 * TIP, met);
        }
        while ((inboard > 0) && ((a->kinds[inboard] & 3) != FLEXURE)) {
            inboard = a->parents[inboard];
        }
        to = (inboard > 0) ? t->sums + 18 * TIP * a->kinds[a->count + inboard] : NULL;
        for (int b = 0; (b < 18 * TIP) && gives && (to != NULL); b += WIDE) {
            put(to + b, add(get(to + b), get(own + b)));
        }
        for (int b = 0; (b < 36) && !gives && (to != NULL); b++) {
            to[TIP * (b / 6) + b % 6] += each[BOTH * (b / 6) + b % 6];
        }
    }
    return sqrt(square);
}

/* Solve n rows of SOLVED in place, whose first n columns are the system; return whether it is regular. */
static int gauss(double *rows, whole n)
{
    for (whole c = 0; c < n; c++) {
        double *pivot = rows + SOLVED * c, by;
        whole best = c, first = c / WIDE * WIDE;
        for (whole r = c + 1; r < n; r++) {
            best = (fabs(rows[SOLVED * r + c]) > fabs(rows[SOLVED * best + c])) ? r : best;
        }
        if (!(fabs(rows[SOLVED * best + c]) > 0.0)) {
            return 0;
        }
        swap_rows(pivot, rows + SOLVED * best, SOLVED);
        by = 1.0 / pivot[c];
        for (whole b = first; b < SOLVED; b += WIDE) {
            put(pivot + b, scale(by, get(pivot + b)));
        }
        for (whole r = 0; r < n; r++) {
            double *row = rows + SOLVED * r;
            by = row[c];
            for (whole b = first; (b < SOLVED) && (r != c); b += WIDE) {
                put(row + b, sub(get(row + b), scale(by, get(pivot + b))));
            }
        }
    }
    return 1;
}

/* Fill motions and fields, and `norm` of G where it is asked for; return whether every N is regular. */
static int branch_out(const arm *a, const here *h, const double *wrenches, const double *changes, const double *derived,
                      const double *start, whole end, const branches *t, double *motion, double *field, double *norm)
{
    whole count = a->count;
    double unit[6 * BOTH] = {0.0};
    fill(t->answers, 6 * BOTH * count);
    for (int b = 0; b < 6; b++) {
        unit[BOTH * b + b] = 1.0;
    }
    push_back(a, h, wrenches, changes, BOTH, unit, 0, t->answers);
    for (whole k = 1; k < count; k++) {
        if ((a->kinds[k] & 3) == FLEXURE) {
            whole at = 6 * TIP * a->kinds[count + k];
            double turned_[6 * TIP] = {0.0};
            add_product(6, 1.0, derived + 36 * a->kinds[count + k], 6, 1, t->meets + at, TIP, 6, turned_, TIP, TIP);
            lift(h, k, turned_, t->met + at);
            lift(h, k, t->moves + at, t->across + at);
        }
    }
    if (norm != NULL) {
        *norm = norm_of(a, h, t);
        if (!(*norm <= SHARE)) {
            return 0;
        }
    }
    for (int b = 0; b < 36; b++) {
        t->answers[6 * BOTH * end + BOTH * (b / 6) + 6 + b % 6] = start[TIP * (b / 6) + b % 6];
    }
    for (whole k = count - 1; k > 0; k--) {
        double *own = t->answers + 6 * BOTH * k, *inboard = t->answers + 6 * BOTH * a->parents[k];
        whole i = a->kinds[count + k], rank = ((a->kinds[k] & 3) == FLEXURE) ? h->begins[i + 1] - h->begins[i] : 0;
        if (rank > 0) {
            const double *met = t->met + 6 * TIP * i;
            double moved[6 * TIP], *system = t->systems + 6 * SOLVED * i;
            move_flexure(h->loads + 6 * k, t->across + 6 * TIP * i, own, BOTH, moved);
            fill(system, SOLVED * rank);
            add_product(rank, 1.0, met, 1, TIP, moved, TIP, 6, system, SOLVED, TIP);
            add_product(rank, 1.0, met, 1, TIP, own, BOTH, 6, system + TIP, SOLVED, BOTH);
            for (whole z = 0; z < rank; z++) {
                system[SOLVED * z + z] += 1.0;
            }
            if (!gauss(system, rank)) {
                return 0;
            }
            add_product(6, -1.0, moved, TIP, 1, system + TIP, SOLVED, rank, own, BOTH, BOTH);
        }
        for (int b = 0; b < 6 * BOTH; b += WIDE) {
            put(inboard + b, add(get(inboard + b), get(own + b)));
        }
    }
    fill(motion, 6 * TIP);
    for (whole k = 0; k < count; k++) {
        const double *own = t->answers + 6 * BOTH * k, *before = motion + 6 * TIP * a->parents[k];
        whole i = a->kinds[count + k], rank = ((a->kinds[k] & 3) == FLEXURE) ? h->begins[i + 1] - h->begins[i] : 0;
        double *moves = motion + 6 * TIP * k, *answers = field + 6 * TIP * k, rates[6 * TIP];
        for (int b = 0; b < 6; b++) { /* columns beyond those of the frame are not read */
            put(answers + TIP * b, get(own + BOTH * b + 6));
            put(answers + TIP * b + WIDE, get(own + BOTH * b + 6 + WIDE));
        }
        if (k > 0) {
            add_product(6, -1.0, own, BOTH, 1, before, TIP, 6, answers, TIP, TIP);
            memcpy(moves, before, 6 * TIP * sizeof *moves);
        }
        for (whole z = 0; z < rank; z++) {
            const double *solved = t->systems + 6 * SOLVED * i + SOLVED * z + TIP;
            put(rates + TIP * z, get(solved + 6));
            put(rates + TIP * z + WIDE, get(solved + 6 + WIDE));
            add_product(1, -1.0, solved, 0, 1, before, TIP, 6, rates + TIP * z, 0, TIP);
        }
        if (rank > 0) {
            add_product(6, 1.0, t->across + 6 * TIP * i, TIP, 1, rates, TIP, rank, moves, TIP, TIP);
        }
    }
    return 1;
}
#endif /* CONTROLLER */

/* Fill the twists that loads are met along, from rows of R and the derivatives of the flexures' exp6. */
static void meet(const arm *a, const here *h, const double *roots, const double *derived, double *met)
{
    memcpy(met, h->screws + 6 * a->driven, (size_t)(6 * (a->passive + h->rank)) * sizeof *met);
    for (whole c = 0; c < h->rank; c++) {
        whole k = h->carriers[a->driven + a->passive + c];
        if (k > 0) {
            double own[6];
            for (int b = 0; b < 6; b++) {
                own[b] = dot6(derived + 36 * h->owner[c] + 6 * b, roots + 6 * c);
            }
            screw(h, k, own, met + 6 * (a->passive + c));
        }
    }
}

/* Fill what a frame's unit motions are as those of what carries it. */
static void begin_at(const double *at, double *start)
{
    fill(start, 6 * TIP);
    for (int b = 0; b < 3; b++) {
        double still[3] = {0.0}, lever[3];
        start[TIP * b + b] = start[TIP * (3 + b) + 3 + b] = still[b] = 1.0;
        cross(at, still, lever);
        for (int i = 0; i < 3; i++) {
            start[(3 + i) * TIP + b] = lever[i];
        }
    }
}

static void respond_rows(const arm *a, whole rows, const double *q, const double *flexed, const double *twists,
                         const double *forces, const double *idle, const asked *f, double *room)
{
    whole d = a->driven, p = a->passive, n = a->flexures, m = a->rows, count = a->count, first = d + p, ties = a->ties, rank = -1;
    here h = memory(a, &room);
    double *roots = take(&room, 36 * n), *derived = take(&room, 36 * n), *by = take(&room, m * (p + 6 * n)), *met = take(&room, 6 * (p + 6 * n));
    double *right = take(&room, TIP * (p + 6 * n + m)), *motion = take(&room, count * 6 * TIP), *field = take(&room, count * 6 * TIP);
    double *carried = take(&room, count), *rest, unit = 0.0, start[6 * TIP];
    int answers = f->laws || f->per_load || f->joints || f->at_sites || f->motions || f->distance, even, rooted = 1;
#if !defined(CONTROLLER)
    int branched = (ties == 0) && (p == 0), bent = (a->starts[n] > 0) || (a->terms > 0);
    double *tangents = take(&room, 36 * n);
    branches tree = {0};
    if (branched) {
        rooted = (f->distance != NULL) || !(bent || (a->law_rows > 1));
        tree = branched_off(a, &room);
    }
#endif /* CONTROLLER */
    work w;
    memset(&w, 0, sizeof w);
    fill(carried, count);
    for (whole k = (whole)f->end[15]; k > 0; k = a->parents[k]) {
        carried[k] = 1.0;
    }
    carried[0] = 1.0;
    for (whole row = 0; row < rows; row++) {
        const double *here_q = q + row * d, *loose_joints = flexed + row * p, *force = right;
        const double *pushing = a->wrenches + 9 * a->pushes * ((row < a->wrench_rows) ? row : a->wrench_rows - 1);
        const double *changes = (a->change_rows > 0) ? a->changes + 36 * a->pushes * ((row < a->change_rows) ? row : a->change_rows - 1) : NULL;
        const double *laws = a->compliance + 36 * n * ((row < a->law_rows) ? row : a->law_rows - 1);
        int dense = 1, other = (row == 0) || (a->law_rows > 1);
        whole total;
        double turn[9], at[3];
        memcpy(h.twists, twists + row * 6 * n, (size_t)(6 * n) * sizeof *twists);
        if (m > 0) {
            memcpy(h.forces, forces + row * m, (size_t)m * sizeof *forces);
        }
        place(a, here_q, loose_joints, 1, &h);
        (void)join(a, here_q, loose_joints, &h);
        weigh(a, pushing, &h);
        for (whole i = 0; (i < f->frames) && (f->loads != NULL); i++) {
            whole k = f->places[i];
            compose(h.turn + 9 * k, h.origin + 3 * k, f->numbers + 12 * i, turn, at);
            borne(h.loads + 6 * f->places[f->frames + i], turn, at, f->loads + 6 * (row * f->sites + i));
        }
        for (whole i = 0; (i < f->bodies) && (f->poses != NULL); i++) {
            whole k = f->body_places[i];
            compose(h.turn + 9 * k, h.origin + 3 * k, f->body_numbers + 12 * i, turn, at);
            pose(turn, at, f->poses + 16 * (row * f->bodies + i));
        }
        if (f->loads != NULL) {
            double *behind = f->loads + 6 * (row * f->sites + f->frames);
            fill(behind, 6 * (f->sites - f->frames));
            for (whole t = 0; t < ties; t++) {
                for (whole r = a->joins[6 * t + 3]; r < a->joins[6 * t + 4]; r++) {
                    for (int b = 0; b < 6; b++) {
                        behind[6 * t + b] += h.forces[r] * a->row[6 * r + b];
                    }
                }
            }
        }
        if (!answers) {
            continue;
        }
#if !defined(CONTROLLER)
        if (bent) {
            bear(a, &h);
            tangents_at(a, laws, a->weights + a->terms * ((row < a->weight_rows) ? row : a->weight_rows - 1), h.load, tangents);
            laws = tangents;
            other = 1;
        }
#endif /* CONTROLLER */
        if (other && rooted) {
            unit = 1.0 / sqrt(fmax(root(a, laws, &h, roots, &even), 1e-9));
        }
        for (whole i = 0; i < n; i++) {
            right_jacobian(h.twists + 6 * i, derived + 36 * i);
        }
        frame_at(&h, f->end, turn, at);
        begin_at(at, start);
#if !defined(CONTROLLER)
        if (branched) {
            if (other) {
                keep_laws(a, &h, laws, rooted ? roots : NULL, &tree);
            }
            dense = !branch_out(a, &h, pushing, changes, derived, start, (whole)f->end[15], &tree, motion, field,
                                (f->distance != NULL) ? f->distance + row : NULL);
        }
#endif /* CONTROLLER */
        if (dense) {
            if (!rooted) {
                unit = 1.0 / sqrt(fmax(root(a, laws, &h, roots, &even), 1e-9));
            }
            total = p + h.rank;
            place_laws(a, &h, h.roots, h.screws + 6 * first);
            meet(a, &h, roots, derived, met);
            if (h.rank != rank) {
                rank = h.rank;
                rest = room;
                w = divided(a, p, rank, &rest);
            }
            if (m > 0) {
                open_gaps(a, &h, h.screws + 6 * d, total, h.roots, h.rank, h.by);
                open_gaps(a, &h, met, total, roots, h.rank, by);
            }
            stiffen(a, &h, &w, pushing, changes, met);
            if (f->distance != NULL) {
                f->distance[row] = proof(w.stiff, total, w.wide, w.matrix, w.side);
            }
            (void)system_of(a, &h, &w, idle + row * m * m, unit, by);
            fill(right, TIP * (total + m));
            for (whole z = 0; z < total; z++) {
                for (int b = 0; (b < TIP) && (carried[h.carriers[d + z]] > 0.0); b += WIDE) {
                    put(right + TIP * z + b, sum_of(met + 6 * z, start + b, TIP, 6));
                }
            }
            solve(w.matrix, total + m, w.side, w.order, right, TIP);
            for (whole r = 0; r < TIP * m; r++) {
                right[TIP * total + r] *= unit;
            }
            force = right + TIP * total;
            spread_out(a, &h, pushing, changes, right, total, TIP, (m > 0) ? force : NULL, motion, field);
            for (whole k = 0; k < count; k++) {
                double *own = field + k * 6 * TIP;
                for (int b = 0; b < 6 * TIP; b += WIDE) {
                    put(own + b, sub(scale(carried[k], get(start + b)), get(own + b)));
                }
            }
        }
        for (whole i = 0; (i < n) && ((f->laws != NULL) || (f->per_load != NULL)); i++) {
            whole e = a->flexure[i], to = (row * 6 * n + i) * 6;
            double own[6 * TIP] = {0.0}, by_law[6 * TIP] = {0.0}, by_load[6 * TIP] = {0.0};
            if (e >= 0) {
                turn_in(field + e * 6 * TIP, h.turn + 9 * e, h.origin + 3 * e, 1.0, own);
                add_product(6, 1.0, derived + 36 * i, 1, 6, own, TIP, 6, by_law, TIP, TIP);
            } else {
                double each[36] = {0.0};
                slots(a, -1 - e, force, each, 6);
                for (int b = 0; b < 36; b++) {
                    by_law[TIP * (b % 6) + b / 6] = each[b];
                }
            }
            if (f->laws != NULL) {
                transpose(by_law, f->laws + to, 6 * n);
            }
            if (f->per_load != NULL) {
                add_product(6, 1.0, laws + 36 * i, 1, 6, by_law, TIP, 6, by_load, TIP, TIP);
                transpose(by_load, f->per_load + to, 6 * n);
            }
        }
        if (f->joints != NULL) {
            double *out = f->joints + row * 6 * d;
            fill(out, 6 * d);
            for (whole j = 0; j < d; j++) {
                double own[TIP] = {0.0};
                if (h.carriers[j] > 0) {
                    add_product(1, 1.0, h.screws + 6 * j, 0, 1, field + h.carriers[j] * 6 * TIP, TIP, 6, own, 0, TIP);
                }
                for (int b = 0; b < 6; b++) {
                    out[b * d + j] = own[b];
                }
            }
            for (whole t = 0; t < ties; t++) {
                const whole *j6 = a->joins + 6 * t;
                whole j = (j6[0] == GEAR) ? a->kinds[count + j6[2]] : j6[5];
                double by_one = (j6[0] == GEAR) ? a->tie[45 * t + 24] : 1.0;
                for (int b = 0; (b < 6) && ((j6[0] == ROD) || ((j6[0] == GEAR) && (j < d))); b++) {
                    out[b * d + j] += by_one * force[TIP * j6[3] + b];
                }
            }
        }
        if (f->at_sites != NULL) {
            double *out = f->at_sites + row * 36 * f->sites, ends[2][6 * TIP];
            whole closures = 0;
            fill(out, 36 * f->sites);
            for (whole i = 0; i < f->frames; i++) {
                whole k = f->places[i], e = f->places[f->frames + i];
                compose(h.turn + 9 * k, h.origin + 3 * k, f->numbers + 12 * i, turn, at);
                memcpy(ends[0], field + e * 6 * TIP, sizeof ends[0]);
                for (whole z = 0; (z < p) && (k == e); z++) { /* outboard of a passive joint its axis stays */
                    for (int b = 0; (b < TIP) && (h.carriers[d + z] == k); b += WIDE) {
                        turn_back(&h, d + z, get(right + TIP * z + b), ends[0] + b, TIP);
                    }
                }
                answer(ends[0], turn, at, 1.0, out + 6 * i, 6 * f->sites);
            }
            for (whole t = 0; t < ties; t++) {
                if (a->joins[6 * t] < COIL) {
                    slots(a, t, force, out + 6 * (f->frames + t), 6 * f->sites);
                    closures++;
                }
            }
            for (whole t = 0; (t < closures) && (a->joins[6 * t] != GEAR); t++) {
                memset(ends, 0, sizeof ends);
                tied(a, &h, t, force, motion, ends[0], ends[1], TIP);
                for (int side = 0; side < 2; side++) {
                    whole k = a->joins[6 * t + 1 + side];
                    point_of(&h, k, a->tie + 45 * t + 3 * side, at);
                    for (int i = 0; i < 3; i++) {
                        through(h.turn + 9 * k + 3 * i, a->tie + 45 * t + 27 + 9 * side, turn + 3 * i);
                    }
                    answer(ends[side], turn, at, -1.0, out + 6 * (f->frames + closures + 2 * t + side), 6 * f->sites);
                }
            }
        }
        for (whole i = 0; (i < f->bodies) && (f->motions != NULL); i++) {
            whole k = f->body_places[i];
            double each[6 * TIP];
            point_of(&h, k, f->body_numbers + 12 * i + 9, at);
            for (int b = 0; b < TIP; b += WIDE) {
                const double *moved = motion + k * 6 * TIP + b;
                packs about = columns(moved + 3 * TIP, TIP), way = sum(columns(moved, TIP), crossed(about, spread3(at)));
                put_columns(each + b, TIP, way);
                put_columns(each + b + 3 * TIP, TIP, about);
            }
            transpose(each, f->motions + 36 * (row * f->bodies + i), 6);
        }
    }
}

API whole engine_rest(const arm *a, whole rows, const double *q, whole settled, whole first, double *free_joints,
                  double *idle, const rested *found, double *room)
{
    whole done = rest_rows(a, rows, q, settled, first, free_joints, idle, found, room);
    whole_again(a, room);
    return done;
}

API void engine_respond(const arm *a, whole rows, const double *q, const double *flexed, const double *twists,
                    const double *forces, const double *idle, const asked *found, double *room)
{
    respond_rows(a, rows, q, flexed, twists, forces, idle, found, room);
    whole_again(a, room);
}

#if !defined(CONTROLLER)
void engine_tips(const arm *a, whole rows, const double *q, double *poses, double *room)
{
    double *lent = room;
    here h = memory(a, &room);
    for (whole row = 0; row < rows; row++) {
        double turn[9], at[3];
        place(a, q + row * a->driven, NULL, 1, &h);
        frame_at(&h, a->elements + 20 * a->count, turn, at);
        pose(turn, at, poses + 16 * row);
    }
    whole_again(a, lent);
}

whole engine_chain(const arm *a, whole rows, const double *q, whole exact, double *displacement, double *loads,
                   double *twists, unsigned char *fine, double *room)
{
#if defined(PACKED)
    return chain_many(a, 0, rows, q, (int)exact, displacement, loads, twists, fine, room);
#else
    return chain_one(a, 0, rows, q, (int)exact, displacement, loads, twists, fine, room);
#endif
}

whole engine_size(void)
{
    return (whole)sizeof(arm);
}

int engine_level(void)
{
#if defined(__x86_64__) && defined(__GNUC__)
    unsigned a, b, c, d, low, high;
    int wide;
    if (!__get_cpuid(1, &a, &b, &c, &d) || ((c & LEAF_1) != LEAF_1)) {
        return 0;
    }
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0)); /* what the system keeps of wide registers */
    (void)high;
    if (((low & 6) != 6) || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || ((b & LEAF_7) != LEAF_7)) {
        return 0;
    }
    wide = ((low & 0xe6) == 0xe6) && ((b & LEAF_7_WIDE) == LEAF_7_WIDE);
    return (__get_cpuid(0x80000001, &a, &b, &c, &d) && ((c & LZCNT) != 0)) ? 1 + wide : 0;
#else
    return 0;
#endif
}

void engine_ready(const arm *a, double *room)
{
    state_one s = divide_one(a, room);
    look_one(a, &s);
}

int engine_one(const asked_one *o, const double *q)
{
    const arm *a = o->arm;
    unsigned char fine = 0;
    for (whole j = 0; j < a->driven; j++) {
        if (!((a->bounds[j] <= q[j]) && (q[j] <= a->bounds[a->driven + j]))) {
            return 0;
        }
    }
    (void)chain_one(a, 1, 1, q, 1, o->displacement, o->loads, o->twists, &fine, o->room);
    return fine;
}
#endif /* CONTROLLER */
#endif /* CHAIN */
