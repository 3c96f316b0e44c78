/* The static equilibrium of compliant arms: tables of one arm with its payload, and what may be asked.
 *
 * All arrays are row by row, all numbers SI, all vectors in base axes where nothing else is said. Python fills the
 * tables from its own arrays, a controller has them as constants. Nothing here allocates: `room` is memory of
 * engine_room() doubles that the caller lends for the time of a call; one for each thread.
 */
#ifndef ENGINE_H
#define ENGINE_H
#include <stdint.h>

typedef int64_t whole;

typedef struct {
    whole count;           /* elements k, the root among them; element 0 stands */
    whole flexures;        /* n */
    whole driven, passive; /* joints: d in q, cylinders among them, and p without a drive */
    whole ties, rows;      /* T closures and springs, m rows that they close */
    whole pushes;          /* L wrenches on links */
    whole terms;           /* B curved terms of laws */
    whole factors;         /* F functions of a column, of which the first is 1; 0 where laws are given by row */
    whole changing;        /* C parts of laws that are affine in the load, times two factors */
    whole law_rows, weight_rows, wrench_rows, change_rows; /* 1 or N; 0 of changes for none */
    const double *elements;   /* (k + 1, 20) rotation, origin, axis, mass, centre, mass outboard; last: tip and gravity */
    const whole *kinds;       /* (3, k) kind, number, order of flexures from base to tip */
    const whole *parents;     /* (k) */
    const double *carried;    /* (T, k) */
    const double *tie;        /* (T, 45) */
    const whole *joins;       /* (T, 6) */
    const double *row, *way;  /* (m, 6) */
    const whole *flexure;     /* (n) element of each, or -1 - its closure */
    const double *compliance, *offset; /* (R, n, 6, 6), (R, n, 6) */
    const double *neurons;    /* (H, 13, 4) units, bias, gains of blocks of four */
    const whole *starts;      /* (n + 1) first block of each flexure */
    const double *bent;       /* (B, 43) matrix, along, whether there is a matrix */
    const double *shapes;     /* (S, 45) kind, bias, exponent, u, form */
    const whole *spans, *pieces; /* (n + 1) terms of flexures, (B + 1) features of terms */
    const double *weights;    /* (1 or N, B), but for factors */
    const double *factor;     /* (F, 6) kind, column, a, b, c, d; of a table a, b, its first knot and how many, below 0
                               * where it closes */
    const double *knots;      /* values of tables */
    const double *change;     /* (C, 45) flexure, first, second, offset, compliance */
    const whole *weighing;    /* (B, 2) factors of terms */
    const whole *varies;      /* (n) whether a flexure has parts that change */
    const double *known;      /* what columns behind those of joints are: the payload's mass, covariates */
    const double *bounds;     /* (2, d) */
    const whole *links;       /* (L, 3) element, flexures inboard, whether it follows */
    const double *wrenches;   /* (1 or N, L, 9) point, force, moment */
    const double *changes;    /* (0, 1 or N, L, 6, 6) */
    const double *pulls;      /* (L, 6) kind, anchor, size, reach of what pulls at links; NULL of wrenches alone */
    const whole *windowed;    /* (B) number of a term's window, below 0 for none; NULL for none at all */
    const double *windows;    /* (W, 79) mean, precision and energy of learned corrections, and where they have faded */
    const double *inertias;   /* (k, 6) xx yy zz xy xz yz of each element about its centre, its axes; of chains that move */
    const double *motion;     /* (N, 2, d) speeds and accelerations of a chain's joints; NULL where it stands */
} arm;

typedef struct { /* (N, ...) where it rests; see engine_rest */
    double *closed, *tips, *flexed, *twists, *loads, *forces, *displacement, *distance, *idles;
    double *ends; /* (N, 4, 4) the flexed tip, NULL where that is not asked for */
} rested;

typedef struct { /* what is asked about a frame where it rests; NULL for what is not */
    const double *end;     /* (16) the frame, as the last row of `elements` has the tip */
    whole frames;          /* f, where twists may be inserted */
    const whole *places;   /* (2, f) */
    const double *numbers; /* (f, 12) */
    whole sites;           /* s: frames and then closures and pins */
    whole bodies;          /* b, frames that wrenches act on */
    const whole *body_places;   /* (2, b) */
    const double *body_numbers; /* (b, 12) */
    double *laws;          /* (N, 6, n, 6) */
    double *per_load;      /* (N, 6, n, 6) */
    double *joints;        /* (N, 6, nq) */
    double *at_sites;      /* (N, 6, s, 6) */
    double *loads;         /* (N, s, 6) */
    double *motions;       /* (N, b, 6, 6) */
    double *poses;         /* (N, b, 4, 4) */
    double *distance;      /* (N) */
} asked;

typedef struct { /* where a row of a chain is answered; twists and loads may be NULL */
    const arm *arm;
    double *displacement, *twists, *loads, *room;
} asked_one;

/* A controller has the text of the engine in its own file: it calls these alone. */
#if defined(CONTROLLER)
#define API static
#else
#define API
whole engine_size(void); /* of an arm in bytes */
whole engine_room(const arm *a);
whole engine_rest_room(const arm *a, whole rank); /* of all but chains, by the coordinates of laws */
int engine_level(void);  /* 1 where the processor has what x86-64-v3 asks for, 2 where v4 */
void engine_ready(const arm *a, double *room);             /* before rows are asked one by one, in the same room */
int engine_one(const asked_one *o, const double *q);
whole engine_chain(const arm *a, whole rows, const double *q, whole exact, double *displacement,
                   double *loads, double *twists, unsigned char *fine, double *room);
void engine_tips(const arm *a, whole rows, const double *q, double *poses, double *room);
#endif
#if !defined(CHAIN)
API whole engine_rest(const arm *a, whole rows, const double *q, whole settled, whole first, double *free_joints,
                      double *idle, const rested *found, double *room);
API void engine_respond(const arm *a, whole rows, const double *q, const double *flexed, const double *twists,
                        const double *forces, const double *idle, const asked *found, double *room);
#endif /* CHAIN */
#endif
