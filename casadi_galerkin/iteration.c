/* One Newton iteration in one pass over the intervals and one back: embed, evaluate pointwise, integrate, condense.

   The Hessian of one interval is dense, its nodes in the order: control values, left joint, right joint.  Eliminating
   the control values (static condensation) leaves a block tridiagonal matrix over the joints, which is eliminated from
   the first to the last as the pass goes on.  W neighbouring intervals are dealt with at once, each in a lane of a
   vector; the last group repeats the last interval.  The joints go one by one.

   Prepended: W, D components, M the degree, R quadrature points, BLOCKS of second derivatives, their NONZEROS with
   ROW and COLUMN, each at its PLACE among the STORED ones, `lanes`, and the function `pointwise`. */

enum {
    INNER = (M - 1) * D,                 /* control values of an interval */
    NODES = (M + 1) * D,                 /* all its values */
    RIGHT = 2,                           /* right-hand sides, kept as further rows of the matrix */
    ROWS = NODES + RIGHT,                /* of a local matrix; column p holds rows p, p + 1, ... */
    FACTOR = INNER * ROWS - INNER * (INNER - 1) / 2, /* length of the columns of the control values */
    PAIR = 2 * D + RIGHT,                /* rows of the matrix over the two joints of an interval */
    JOINT = D * PAIR - D * (D - 1) / 2,  /* length of the columns of the left one */
    CARRIED = D * (D + RIGHT) - D * (D - 1) / 2, /* and of the right one, to which the next interval adds */
    DERIVATIVES = R * BLOCKS * STORED, /* second derivatives of an interval */
};

const int lanes_at_once = W;

struct iteration {
    long intervals, unknowns, shift;   /* value i of node n is entry n D + i - shift of u, but at both ends: */
    double missed;                     /* part of a right-hand side that a solution may miss */
    const long *first, *last;          /* entries of the first and the last joint; given if not below `unknowns` */
    const double *points;              /* of the quadrature, (R) */
    const double *values, *slopes;     /* basis in the order of the local nodes, (R, M + 1) */
    const double *by_x, *by_slope;     /* the same times the weights */
    const double *weights, *products;  /* (R); weight times two basis functions, (pairs of nodes, R, BLOCKS) */
    lanes *factors, *derivatives;      /* (groups, FACTOR) and what follows it, (groups, DERIVATIVES) */
    double *joints;                    /* (intervals + 1, JOINT) */
    const double *u, *mesh, *p, *probe, *rhs;
    double *gradient, *step, *soft, *solution, *excess;
};

/* Elimination of the first columns of a symmetric matrix, without pivoting.  A column keeps the inverse of its pivot,
   then the entries below it as they were before they are divided by the pivot, then its right-hand sides. */
#define ELIMINATION(T, eliminate, forward, backward)                                                                   \
    static inline void eliminate(T *column, int pivots, int rows) {                                                    \
        for (int p = 0; p < pivots; p++, column += rows--) {                                                           \
            T inverse = 1 / column[0], *target = column + rows;                                                        \
            for (int j = 1; j < rows - RIGHT; target += rows - j++) {                                                  \
                T factor = column[j] * inverse;                                                                        \
                for (int i = j; i < rows; i++) target[i - j] -= factor * column[i];                                    \
            }                                                                                                          \
            column[0] = inverse;                                                                                       \
        }                                                                                                              \
    }                                                                                                                  \
    static inline void forward(T *column, int pivots, int rows, T *y) { /* one more right-hand side, in place */       \
        for (int p = 0; p < pivots; p++, column += rows--) {                                                           \
            T scaled = y[p] * column[0];                                                                               \
            for (int i = 1; i < rows - RIGHT; i++) y[p + i] -= scaled * column[i];                                     \
            column[rows - RIGHT] = y[p];                                                                               \
        }                                                                                                              \
    }                                                                                                                  \
    static inline void backward(const T *column, int pivots, int rows, int side, T *y) { /* y[pivots], ... are known */ \
        column += pivots * rows - pivots * (pivots - 1) / 2;                                                           \
        for (int p = pivots - 1; p >= 0; p--) {                                                                        \
            int below = rows - p - RIGHT;                                                                              \
            column -= rows - p;                                                                                        \
            T sum = column[below + side];                                                                              \
            for (int i = below - 1; i > 0; i--) sum -= column[i] * y[p + i];                                           \
            y[p] = sum * column[0];                                                                                    \
        }                                                                                                              \
    }

ELIMINATION(lanes, condense, condense_rhs, recover)
ELIMINATION(double, eliminate, forward, backward)

/* Entry of u and of the gradient: value i of joint k, and the first control value of interval k. */
static inline long joint(const struct iteration *s, long k, int i) {
    return k == 0 ? s->first[i] : k == s->intervals ? s->last[i] : k * M * D + i - s->shift;
}
static inline long controls(const struct iteration *s, long k) { return (k * M + 1) * D - s->shift; }
static inline long clamped(const struct iteration *s, long k) { return k < s->intervals ? k : s->intervals - 1; }

/* Values of neighbouring intervals from k on at their control points. */
static inline void gather(const struct iteration *s, long k, const double *from, lanes *to) {
    for (int lane = 0; lane < W; lane++) {
        const double *own = from + controls(s, clamped(s, k + lane));
        for (int p = 0; p < INNER; p++) to[p][lane] = own[p];
    }
}
static inline void scatter(const struct iteration *s, long k, const lanes *from, double *to) {
    for (int lane = 0; lane < W && k + lane < s->intervals; lane++) {
        double *own = to + controls(s, k + lane);
        for (int p = 0; p < INNER; p++) own[p] = from[p][lane];
    }
}

/* Node values -> position and slope at point q, by differences to the left joint. */
static inline void embed(const struct iteration *s, int q, const lanes *nodes, lanes *x, lanes *slope) {
    const double *value = s->values + q * (M + 1), *change = s->slopes + q * (M + 1);
    for (int i = 0; i < D; i++) {
        lanes left = nodes[INNER + i];
        x[i] = left;
        slope[i] = (lanes){0};
        for (int a = 0; a <= M; a++)
            if (a != M - 1) {
                lanes difference = nodes[a * D + i] - left;
                x[i] += value[a] * difference;
                slope[i] += change[a] * difference;
            }
    }
}

/* Add what point q contributes to the integral; to the left joint it is the sum over all nodes, until `complete`. */
static inline void integrate(const struct iteration *s, int q, const lanes *fx, const lanes *fv, lanes *total) {
    const double *by_x = s->by_x + q * (M + 1), *by_slope = s->by_slope + q * (M + 1);
    for (int a = 0; a <= M; a++)
        for (int i = 0; i < D; i++)
            total[a * D + i] += a == M - 1 ? s->weights[q] * fx[i] : by_x[a] * fx[i] + by_slope[a] * fv[i];
}
static inline void complete(lanes *total) {
    for (int a = 0; a <= M; a++)
        for (int i = 0; i < D; i++)
            if (a != M - 1) total[INNER + i] -= total[a * D + i];
}

/* Gradient and second derivatives of the intervals from k on. */
static inline void evaluate(const struct iteration *s, long k, lanes *derivatives, lanes *gradient) {
    lanes nodes[NODES], begin, h;
    gather(s, k, s->u, nodes);
    for (int lane = 0; lane < W; lane++) {
        long own = clamped(s, k + lane);
        for (int i = 0; i < D; i++) {
            nodes[INNER + i][lane] = s->u[joint(s, own, i)];
            nodes[INNER + D + i][lane] = s->u[joint(s, own + 1, i)];
        }
        begin[lane] = s->mesh[own];
        h[lane] = s->mesh[own + 1] - s->mesh[own];
    }
    for (int j = 0; j < NODES; j++) gradient[j] = (lanes){0};
    for (int q = 0; q < R; q++) {
        lanes x[D], slope[D], fx[D], fv[D], t = begin + s->points[q] * h;
        embed(s, q, nodes, x, slope);
        pointwise(&t, &h, x, slope, s->p, fx, fv, derivatives + q * BLOCKS * STORED);
        integrate(s, q, fx, fv, gradient);
    }
    complete(gradient);
}

/* The local Hessian with its right-hand sides at the control values.  Those at a joint are put in when it is passed: what
   two intervals contribute to its gradient cancels, and nothing may be rounded before it does. */
static inline void form(const struct iteration *s, long k, const lanes *derivatives, const lanes *gradient, lanes *h) {
    const double *product = s->products;
    lanes probe[INNER + 1];
    if (NONZEROS < D * D)
        for (int j = 0; j < NODES * ROWS - NODES * (NODES - 1) / 2; j++) h[j] = (lanes){0};
    for (int a = 0; a <= M; a++)
        for (int b = 0; b <= a; b++, product += R * BLOCKS) {
            lanes sum[STORED];
            for (int e = 0; e < STORED; e++) sum[e] = product[0] * derivatives[e];
            for (int q = 1; q < R * BLOCKS; q++)
                for (int e = 0; e < STORED; e++) sum[e] += product[q] * derivatives[q * STORED + e];
            for (int e = 0; e < NONZEROS; e++) {
                int row = a * D + ROW[e], column = b * D + COLUMN[e];
                if (row >= column) h[column * ROWS - column * (column - 1) / 2 + row - column] = sum[PLACE[e]];
            }
        }
    gather(s, k, s->probe, probe);
    for (int column = 0; column < NODES; h += ROWS - column++) {
        h[NODES - column] = column < INNER ? -gradient[column] : (lanes){0};
        h[NODES - column + 1] = column < INNER ? -probe[column] : (lanes){0};
    }
}

/* Make the equations of given values of a joint those of a zero. */
static inline void give(const struct iteration *s, long k, double *pair) {
    for (int i = 0; i < D; i++) {
        if (joint(s, k, i) < s->unknowns) continue;
        double *column = pair;
        for (int j = 0; j < i; column += PAIR - j++) column[i - j] = 0;
        column[0] = 1;
        for (int row = 1; row < PAIR - i; row++) column[row] = 0;
    }
}

/* Eliminate joint k from the matrix `pair` over it and the next; `carried` is what earlier ones left of its columns. */
static inline void pass(const struct iteration *s, long k, double *pair, double *carried) {
    double *column = pair, *from = carried, *kept = s->joints + k * JOINT;
    for (int j = 0; j < D; column += PAIR - j++) {
        for (int i = 0; i < D - j; i++) column[i] += *from++;
        long entry = joint(s, k, j);
        column[PAIR - j - 2] += *from++ - (entry < s->unknowns ? s->gradient[entry] : 0);
        column[PAIR - j - 1] += *from++ - (entry < s->unknowns ? s->probe[entry] : 0);
    }
    if (k == 0 || k == s->intervals) give(s, k, pair);
    eliminate(pair, D, PAIR);
    for (int j = 0; j < JOINT; j++) kept[j] = pair[j];
    for (int j = 0; j < CARRIED; j++) carried[j] = pair[JOINT + j];
}

/* Defect at joint k and size of its right-hand side, added to sums. */
static inline void judge(const struct iteration *s, long k, const double *defect, const double *rhs, double *sums) {
    for (int i = 0; i < D; i++) {
        long entry = joint(s, k, i);
        if (entry < s->unknowns) {
            sums[0] += fabs(defect[i] + rhs[entry]);
            sums[1] += fabs(rhs[entry]);
        }
    }
}

/* Defect of a solution in the intervals from k on: their Hessians times it. */
static inline void apply(const struct iteration *s, const lanes *derivatives, const lanes *y, lanes *defect) {
    for (int j = 0; j < NODES; j++) defect[j] = (lanes){0};
    for (int q = 0; q < R; q++) {
        lanes at[2 * D], f[2 * D];
        embed(s, q, y, at, at + D);
        for (int i = 0; i < 2 * D; i++) f[i] = (lanes){0};
        for (int b = 0; b < BLOCKS; b++, derivatives += STORED)
            for (int e = 0; e < NONZEROS; e++)
                f[BLOCK_ROW[b] * D + ROW[e]] += derivatives[PLACE[e]] * at[BLOCK_COLUMN[b] * D + COLUMN[e]];
        integrate(s, q, f, f + D, defect);
    }
    complete(defect);
}

/* The way back: joints, control values, the defect of the first solution. */
static inline void back(const struct iteration *s, int sides, const double *rhs, double *const *solution) {
    double pair[RIGHT][2 * D] = {{0}}, defect_of_next[D] = {0}, sums[2] = {0};
    long n = s->intervals;
    for (int side = 0; side < sides; side++) backward(s->joints + n * JOINT, D, PAIR, side, pair[side]);
    for (int side = 0; side < sides; side++)
        for (int i = 0; i < D; i++)
            if (joint(s, n, i) < s->unknowns) solution[side][joint(s, n, i)] = pair[side][i];
    for (long k = (n - 1) / W * W; k >= 0; k -= W) {
        int count = n - k < W ? n - k : W;
        lanes y[RIGHT][NODES], defect[NODES], own[INNER + 1], size[2] = {{0}};
        for (int j = 0; j < NODES; j++) y[0][j] = y[1][j] = (lanes){0};
        for (int lane = count - 1; lane >= 0; lane--)
            for (int side = 0; side < sides; side++) {
                double *both = pair[side];
                for (int i = 0; i < D; i++) both[D + i] = both[i];
                backward(s->joints + (k + lane) * JOINT, D, PAIR, side, both);
                for (int i = 0; i < 2 * D; i++) y[side][INNER + i][lane] = both[i];
                for (int i = 0; i < D; i++)
                    if (joint(s, k + lane, i) < s->unknowns) solution[side][joint(s, k + lane, i)] = both[i];
            }
        for (int side = 0; side < sides; side++) {
            recover(s->factors + k / W * FACTOR, INNER, ROWS, side, y[side]);
            scatter(s, k, y[side], solution[side]);
        }
        apply(s, s->derivatives + k / W * DERIVATIVES, y[0], defect);
        gather(s, k, rhs, own);
        for (int p = 0; p < INNER; p++)
            for (int lane = 0; lane < W; lane++) {
                size[0][lane] += fabs(defect[p][lane] + own[p][lane]);
                size[1][lane] += fabs(own[p][lane]);
            }
        for (int lane = count - 1; lane >= 0; lane--) {
            for (int i = 0; i < D; i++) defect_of_next[i] += defect[INNER + D + i][lane];
            judge(s, k + lane + 1, defect_of_next, rhs, sums);
            for (int i = 0; i < D; i++) defect_of_next[i] = defect[INNER + i][lane];
            sums[0] += size[0][lane];
            sums[1] += size[1][lane];
        }
    }
    judge(s, 0, defect_of_next, rhs, sums);
    *s->excess = sums[0] - s->missed * sums[1];
}

/* u, mesh, p, probe -> gradient, step, soft, excess of the step. */
void run(const struct iteration *s) {
    double carried[CARRIED] = {0}, from_left[D] = {0}, pair[JOINT + CARRIED];
    for (long k = 0; k < s->intervals; k += W) {
        lanes gradient[NODES], *h = s->factors + k / W * FACTOR, *derivatives = s->derivatives + k / W * DERIVATIVES;
        evaluate(s, k, derivatives, gradient);
        form(s, k, derivatives, gradient, h);
        condense(h, INNER, ROWS);
        scatter(s, k, gradient, s->gradient);
        for (int lane = 0; lane < W && k + lane < s->intervals; lane++) {
            for (int i = 0; i < D; i++) {
                long entry = joint(s, k + lane, i);
                if (entry < s->unknowns) s->gradient[entry] = from_left[i] + gradient[INNER + i][lane];
                from_left[i] = gradient[INNER + D + i][lane];
            }
            for (int j = 0; j < JOINT + CARRIED; j++) pair[j] = h[FACTOR + j][lane];
            pass(s, k + lane, pair, carried);
        }
    }
    for (int i = 0; i < D; i++)
        if (s->last[i] < s->unknowns) s->gradient[s->last[i]] = from_left[i];
    for (int j = 0; j < JOINT + CARRIED; j++) pair[j] = 0;
    pass(s, s->intervals, pair, carried);
    back(s, RIGHT, s->gradient, (double *[]){s->step, s->soft});
}

/* rhs -> solution and its excess, with the factors of the last run. */
void resolve(const struct iteration *s) {
    double both[2 * D] = {0};
    for (long k = 0; k <= s->intervals; k += W) {
        lanes y[NODES];
        for (int j = 0; j < NODES; j++) y[j] = (lanes){0};
        if (k < s->intervals) {
            gather(s, k, s->rhs, y);
            for (int p = 0; p < INNER; p++) y[p] = -y[p];
            condense_rhs(s->factors + k / W * FACTOR, INNER, ROWS, y);
        }
        for (int lane = 0; lane < W && k + lane <= s->intervals; lane++) {
            int last = k + lane == s->intervals;
            for (int i = 0; i < D; i++) {
                long entry = joint(s, k + lane, i);
                both[i] += last ? 0 : y[INNER + i][lane];
                both[i] = entry < s->unknowns ? both[i] - s->rhs[entry] : 0;
                both[D + i] = last ? 0 : y[INNER + D + i][lane];
            }
            forward(s->joints + (k + lane) * JOINT, D, PAIR, both);
            for (int i = 0; i < D; i++) both[i] = both[D + i];
        }
    }
    back(s, 1, s->rhs, (double *[]){s->solution});
}
