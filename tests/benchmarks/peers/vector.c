// The march without event location, written to be vectorised: what this machine can do.
//
// Blocks of W lanes go through all steps together, their states in arrays of that fixed width. The body of the loop
// over lanes is one whole step without a branch. There are no modes: the normal force is k max(v, 0), the friction
// force is that of the slider where it was at the step's beginning, cut at mu N; at the step's end the slider follows
// (return mapping), which also serves apart, and the case becomes the one that the positions choose, the stretch of
// the friction spring being kept.
//
// As q' = r, the classical Runge-Kutta step is written in its Nystroem form, which needs the accelerations only.

#include <math.h>

#define INLINE static inline __attribute__((always_inline))

#ifndef W  // one vector is the fastest: two leave too few registers
#ifdef __AVX512F__
#define W 8
#else
#define W 4
#endif
#endif

typedef struct {
    double m, I, k_x, k_y, k_T, c_x, c_y, c_T, alpha, l_oa, l_ab, gap, k_d, mu, omega, beta, F_0, M_0, phase[2];
} Parameters;

typedef struct { double a[6]; } Drive;  // accelerations by the drive

typedef struct {
    Drive sine, cosine;
    double damping[3], spring[3], inverse_m, inverse_I;
    double half, lean, height;  // corners: a and b of the left block are (half + lean, height), (half - lean, -height)
    double sin_alpha, cos_alpha, gap, k_d, inverse_k_d, mu;
} Model;

typedef double Lanes[W];

// q, r: positions x1, x2, y1, y2, theta1, theta2 and their rates; of the case: x of the left and of the right block's
// corner, y of both, and whether the tip is on the left block (1 or 0).
typedef struct { Lanes k, q[6], r[6], u_s, l0, r0, y0, tip; } Block;
typedef struct { double l0, r0, y0, tip; } Case;
typedef struct { double l_x, l_y, r_x, r_y, e_x, e_y; } Corners;
typedef struct { double s_A, c_A, v, u; } Slide;

static Model model(const Parameters *p) {
    Model m = {.inverse_m = 1 / p->m, .inverse_I = 1 / p->I, .sin_alpha = sin(p->alpha), .cos_alpha = cos(p->alpha),
               .gap = p->gap, .k_d = p->k_d, .inverse_k_d = 1 / p->k_d, .mu = p->mu};
    const double inertia[3] = {p->m, p->m, p->I}, spring[3] = {p->k_x, p->k_y, p->k_T};
    const double damping[3] = {p->c_x, p->c_y, p->c_T};
    const double drive[3] = {p->F_0 * cos(p->beta), p->F_0 * sin(p->beta), p->M_0};
    for (int i = 0; i < 6; i++) {
        m.sine.a[i] = drive[i / 2] * cos(p->phase[i % 2]) / inertia[i / 2];
        m.cosine.a[i] = drive[i / 2] * sin(p->phase[i % 2]) / inertia[i / 2];
    }
    for (int i = 0; i < 3; i++) m.damping[i] = damping[i] / inertia[i], m.spring[i] = spring[i] / inertia[i];
    m.half = p->l_oa / 2, m.lean = p->l_ab * m.cos_alpha / 2, m.height = p->l_ab * m.sin_alpha / 2;
    return m;
}

// Taylor series of sin x and 1 - cos x, good to 2e-14 up to pi / 4.
INLINE void sine_versine(double x, double *s, double *w) {
    const double a = x * x, b = a * a;
    const double s01 = -1 / 6. + a * (1 / 120.), s23 = -1 / 5040. + a * (1 / 362880.);
    const double s45 = -1 / 39916800. + a * (1 / 6227020800.);
    const double w01 = 1 / 2. - a * (1 / 24.), w23 = 1 / 720. - a * (1 / 40320.);
    const double w45 = 1 / 3628800. - a * (1 / 479001600.);
    *s = x + x * a * (s01 + b * (s23 + b * s45));
    *w = a * (w01 + b * (w23 + b * (w45 + b * (1 / 87178291200.))));
}

INLINE Corners corners(const Model *m, const double *q, double s1, double w1, double s2, double w2, const Case *c) {
    const double l_dx = c->y0 * s1 - c->l0 * w1, r_dx = c->y0 * s2 - c->r0 * w2;
    const double l_dy = c->y0 * w1 + c->l0 * s1, r_dy = c->y0 * w2 + c->r0 * s2;
    return (Corners){c->l0 + l_dx,  c->y0 - l_dy, c->r0 + r_dx, c->y0 - r_dy, (q[0] - q[1] - m->gap) + (l_dx - r_dx),
                     (q[2] - q[3]) - (l_dy - r_dy)};
}

INLINE Slide slide(const Model *m, const Corners *at, double s1, double w1, double s2, double w2, double tip) {
    const double s_f = s1 + tip * (s2 - s1), w_f = w1 + tip * (w2 - w1);
    const double s_A = m->sin_alpha - (m->sin_alpha * w_f + m->cos_alpha * s_f);
    const double c_A = m->cos_alpha - (m->cos_alpha * w_f - m->sin_alpha * s_f);
    return (Slide){s_A, c_A, at->e_x * s_A - at->e_y * c_A, at->e_x * c_A + at->e_y * s_A};
}

INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double cut(double x, double limit) { return larger(smaller(x, limit), -limit); }

INLINE void accelerations(const Model *m, const double *q, const double *r, const Drive *drive, double k, double u_s,
                          double tip, const Corners *at, const Slide *s, double *a) {
    const double N = k * larger(s->v, 0), F = cut(m->k_d * (s->u - u_s), m->mu * N);
    const double R_x = N * s->s_A + F * s->c_A, R_y = N * s->c_A - F * s->s_A;  // leftwards, up; on the left block
    const double both = s->u * N - s->v * F, on_right = tip * both;  // moment about the face's own corner
    const double M_1 = (both - on_right) - (at->l_y * R_x + at->l_x * R_y);
    const double M_2 = on_right + (at->r_x * R_y + at->r_y * R_x);
    const double load[6] = {-R_x * m->inverse_m, R_x * m->inverse_m, R_y * m->inverse_m,
                            -R_y * m->inverse_m, M_1 * m->inverse_I, M_2 * m->inverse_I};
    for (int i = 0; i < 6; i++)
        a[i] = drive->a[i] + load[i] - (m->damping[i / 2] * r[i] + m->spring[i / 2] * q[i]);
}

INLINE void slope(const Model *m, const double *q, const double *r, const Drive *drive, double k, double u_s,
                  const Case *c, double *a) {
    double s1, w1, s2, w2;
    sine_versine(q[4], &s1, &w1);
    sine_versine(q[5], &s2, &w2);
    const Corners at = corners(m, q, s1, w1, s2, w2, c);
    const Slide s = slide(m, &at, s1, w1, s2, w2, c->tip);
    accelerations(m, q, r, drive, k, u_s, c->tip, &at, &s, a);
}

// The same where a step starts, after slider and case have followed the positions.
INLINE void first_slope(const Model *m, const double *q, const double *r, const Drive *drive, double k, double *u_s,
                        Case *c, double *a) {
    double s1, w1, s2, w2;
    sine_versine(q[4], &s1, &w1);
    sine_versine(q[5], &s2, &w2);
    const Corners before = corners(m, q, s1, w1, s2, w2, c);
    const Slide old = slide(m, &before, s1, w1, s2, w2, c->tip);
    const double stretch = cut(old.u - *u_s, m->mu * m->inverse_k_d * k * larger(old.v, 0));

    const double side = -copysign(1, q[5] - q[4]);  // 1: the upper corners, -1: the lower ones
    c->y0 = side * m->height, c->l0 = side * m->lean + m->half, c->r0 = side * m->lean - m->half;
    const Corners at = corners(m, q, s1, w1, s2, w2, c);
    c->tip = 0.5 - copysign(0.5, side * at.e_y);
    const Slide s = slide(m, &at, s1, w1, s2, w2, c->tip);
    *u_s = s.u - stretch;
    accelerations(m, q, r, drive, k, *u_s, c->tip, &at, &s, a);
}

INLINE void step(const Model *m, Block *b, double h, const Drive *start, const Drive *middle, const Drive *end) {
    const double half = h / 2, sixth = h / 6;
    for (int l = 0; l < W; l++) {
        double q0[6], r0[6], q[6], r[6], a1[6], a2[6], a3[6], a4[6], u_s = b->u_s[l];
        Case c = {b->l0[l], b->r0[l], b->y0[l], b->tip[l]};
        const double k = b->k[l];
        for (int i = 0; i < 6; i++) q0[i] = b->q[i][l], r0[i] = b->r[i][l];
        first_slope(m, q0, r0, start, k, &u_s, &c, a1);
        b->u_s[l] = u_s, b->l0[l] = c.l0, b->r0[l] = c.r0, b->y0[l] = c.y0, b->tip[l] = c.tip;
        for (int i = 0; i < 6; i++) q[i] = q0[i] + half * r0[i], r[i] = r0[i] + half * a1[i];
        slope(m, q, r, middle, k, u_s, &c, a2);
        for (int i = 0; i < 6; i++) q[i] += half * half * a1[i], r[i] = r0[i] + half * a2[i];
        slope(m, q, r, middle, k, u_s, &c, a3);
        for (int i = 0; i < 6; i++) q[i] = q0[i] + h * (r0[i] + half * a2[i]), r[i] = r0[i] + h * a3[i];
        slope(m, q, r, end, k, u_s, &c, a4);
        for (int i = 0; i < 6; i++) {
            const double both = a2[i] + a3[i];
            b->q[i][l] = q0[i] + h * (r0[i] + sixth * (a1[i] + both));
            b->r[i][l] = r0[i] + sixth * (a1[i] + 2 * both + a4[i]);
        }
    }
}

INLINE Drive drive_at(const Model *m, const double *wave) {
    Drive d;
    for (int i = 0; i < 6; i++) d.a[i] = m->sine.a[i] * wave[0] + m->cosine.a[i] * wave[1];
    return d;
}

static void march(const Model *m, Block *b, int steps, int periods, double h, const double *waves) {
    for (int period = 0; period < periods; period++) {
        Drive start = drive_at(m, waves);
        for (int i = 0; i < steps; i++) {
            const Drive middle = drive_at(m, waves + 4 * i + 2), end = drive_at(m, waves + 4 * i + 4);
            step(m, b, h, &start, &middle, &end);
            start = end;
        }
    }
}

// All lanes; `waves` is the drive's sine and cosine at half steps of one period, 2 steps + 1 pairs.
void run(const Parameters *p, const double *springs, int lanes, int steps, int periods, const double *waves,
         double *ends) {
    const Model m = model(p);
    for (int first = 0; first < lanes; first += W) {
        Block b __attribute__((aligned(64))) = {0};
        for (int l = 0; l < W; l++) {
            b.k[l] = springs[first + l < lanes ? first + l : lanes - 1];
            b.l0[l] = m.half - m.lean, b.r0[l] = -m.lean - m.half, b.y0[l] = -m.height;
        }
        march(&m, &b, steps, periods, 2 * M_PI / p->omega / steps, waves);
        for (int l = 0; l < W && first + l < lanes; l++)
            for (int i = 0; i < 6; i++)
                ends[12 * (first + l) + i] = b.q[i][l], ends[12 * (first + l) + 6 + i] = b.r[i][l];
    }
}
