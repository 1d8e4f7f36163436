// One lane at a time: RK4 of fixed step, events located by bisection of the step.
//
// Positions q are x1, x2, y1, y2, theta1, theta2, rates r theirs; block 0 is the left one. As q' = r, the classical
// Runge-Kutta step is written in its Nystroem form, which needs the accelerations only. The contact of a step's end
// serves both its guards and the first stage of the next step. While the blades are apart there is no trigonometry.

#include <math.h>
#include <stdbool.h>

#define INLINE static inline __attribute__((always_inline))

enum { APART, STICK, SLIP_PLUS, SLIP_MINUS };
enum { LIFT = 1, TURN = 2, HEIGHT = 4, LIMIT = 8, REVERSE = 16 };  // guards, in order of precedence

static const double TINY = 1e-16;  // [m] by which the friction spring may exceed its limit: rounding
static const int MAX_EVENTS = 64;  // in a step

typedef struct {
    double m, I, k_x, k_y, k_T, c_x, c_y, c_T, alpha, l_oa, l_ab, gap, k_d, mu, omega, beta, F_0, M_0, phase[2];
} Parameters;

typedef struct {
    double sine[6], cosine[6], damping[6], spring[6];  // accelerations by the drive and by the blade
    double inverse_m, inverse_I, l0[2], r0[2], y0[2];  // corners of the lower and of the upper pair
    double sin_alpha, cos_alpha, gap, k_d, mu, omega, k, lag;
} Model;

typedef struct { double q[6], r[6]; } Motion;
typedef struct { int mode, upper, left_tip; double u_s; } Held;
typedef struct { double s, c; } Wave;  // sine and cosine of the drive's phase

typedef struct {
    double l_x, l_y, r_x, r_y;  // corners about the centres of their blocks
    double e_x, e_y, s_A, c_A, v, u;
} Touch;

static Model model(const Parameters *p) {
    Model m = {.inverse_m = 1 / p->m, .inverse_I = 1 / p->I, .sin_alpha = sin(p->alpha), .cos_alpha = cos(p->alpha),
               .gap = p->gap, .k_d = p->k_d, .mu = p->mu, .omega = p->omega};
    const double inertia[3] = {p->m, p->m, p->I}, spring[3] = {p->k_x, p->k_y, p->k_T};
    const double damping[3] = {p->c_x, p->c_y, p->c_T};
    const double drive[3] = {p->F_0 * cos(p->beta), p->F_0 * sin(p->beta), p->M_0};
    for (int i = 0; i < 6; i++) {
        const int axis = i / 2, blade = i % 2;
        m.sine[i] = drive[axis] * cos(p->phase[blade]) / inertia[axis];
        m.cosine[i] = drive[axis] * sin(p->phase[blade]) / inertia[axis];
        m.damping[i] = damping[axis] / inertia[axis];
        m.spring[i] = spring[axis] / inertia[axis];
    }
    const double lean = p->l_ab * m.cos_alpha / 2, half = p->l_oa / 2, height = p->l_ab * m.sin_alpha / 2;
    m.l0[1] = half + lean, m.r0[1] = lean - half, m.y0[1] = height;
    m.l0[0] = half - lean, m.r0[0] = -lean - half, m.y0[0] = -height;
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

INLINE Touch touch_at(const Model *m, const double *q, double s1, double w1, double s2, double w2, int upper,
                      bool left_tip) {
    Touch t;
    const double l0 = m->l0[upper], r0 = m->r0[upper], y0 = m->y0[upper];
    const double l_dx = y0 * s1 - l0 * w1, r_dx = y0 * s2 - r0 * w2;
    const double l_dy = -y0 * w1 - l0 * s1, r_dy = -y0 * w2 - r0 * s2;
    t.l_x = l0 + l_dx, t.l_y = y0 + l_dy, t.r_x = r0 + r_dx, t.r_y = y0 + r_dy;
    t.e_x = (q[0] - q[1] - m->gap) + (l_dx - r_dx);
    t.e_y = (q[2] - q[3]) + (l_dy - r_dy);
    const double s_f = left_tip ? s2 : s1, w_f = left_tip ? w2 : w1;
    t.s_A = m->sin_alpha - (m->sin_alpha * w_f + m->cos_alpha * s_f);
    t.c_A = m->cos_alpha - (m->cos_alpha * w_f - m->sin_alpha * s_f);
    t.v = t.e_x * t.s_A - t.e_y * t.c_A;
    t.u = t.e_x * t.c_A + t.e_y * t.s_A;
    return t;
}

INLINE Touch touch(const Model *m, const double *q, int upper, bool left_tip) {
    double s1, w1, s2, w2;
    sine_versine(q[4], &s1, &w1);
    sine_versine(q[5], &s2, &w2);
    return touch_at(m, q, s1, w1, s2, w2, upper, left_tip);
}

INLINE void free_accelerations(const Model *m, const double *q, const double *r, Wave w, double *a) {
    for (int i = 0; i < 6; i++)
        a[i] = (m->sine[i] * w.s + m->cosine[i] * w.c) - (m->damping[i] * r[i] + m->spring[i] * q[i]);
}

// Accelerations by drive, blades and contact; F = k_d (u - u_s) + rub N with one of k_d and rub zero.
INLINE void accelerations(const Model *m, const double *q, const double *r, Wave w, const Touch *t, bool left_tip,
                          double k_d, double u_s, double rub, double *a) {
    const double N = m->k * t->v, F = k_d * (t->u - u_s) + rub * N;
    const double R_x = -(N * t->s_A + F * t->c_A), R_y = N * t->c_A - F * t->s_A;
    const double on_face = t->u * N - t->v * F;  // moment of R about the face's own corner
    const double M_1 = t->l_y * R_x - t->l_x * R_y + (left_tip ? 0 : on_face);
    const double M_2 = t->r_x * R_y - t->r_y * R_x + (left_tip ? on_face : 0);
    free_accelerations(m, q, r, w, a);
    a[0] += R_x * m->inverse_m, a[1] -= R_x * m->inverse_m;
    a[2] += R_y * m->inverse_m, a[3] -= R_y * m->inverse_m;
    a[4] += M_1 * m->inverse_I, a[5] += M_2 * m->inverse_I;
}

INLINE void slope(const Model *m, const double *q, const double *r, Wave w, bool free, int upper, bool left_tip,
                  double k_d, double u_s, double rub, double *a) {
    if (free) {
        free_accelerations(m, q, r, w, a);
    } else {
        const Touch t = touch(m, q, upper, left_tip);
        accelerations(m, q, r, w, &t, left_tip, k_d, u_s, rub, a);
    }
}

INLINE void rk4_in(const Model *m, const Motion *z, const double *a1, double h, Wave middle, Wave end, bool free,
                   int upper, bool left_tip, double k_d, double u_s, double rub, Motion *to) {
    const double half = h / 2, sixth = h / 6;
    double q[6], r[6], a2[6], a3[6], a4[6];
    for (int i = 0; i < 6; i++) q[i] = z->q[i] + half * z->r[i], r[i] = z->r[i] + half * a1[i];
    slope(m, q, r, middle, free, upper, left_tip, k_d, u_s, rub, a2);
    for (int i = 0; i < 6; i++) q[i] += half * half * a1[i], r[i] = z->r[i] + half * a2[i];
    slope(m, q, r, middle, free, upper, left_tip, k_d, u_s, rub, a3);
    for (int i = 0; i < 6; i++) q[i] = z->q[i] + h * (z->r[i] + half * a2[i]), r[i] = z->r[i] + h * a3[i];
    slope(m, q, r, end, free, upper, left_tip, k_d, u_s, rub, a4);
    for (int i = 0; i < 6; i++) {
        const double b = a2[i] + a3[i];
        to->q[i] = z->q[i] + h * (z->r[i] + sixth * (a1[i] + b));
        to->r[i] = z->r[i] + sixth * (a1[i] + 2 * b + a4[i]);
    }
}

INLINE double sign_of(int mode) { return mode == SLIP_PLUS ? 1 : mode == SLIP_MINUS ? -1 : 0; }

INLINE void rk4(const Model *m, const Held *held, const Motion *z, const double *a1, double h, Wave middle, Wave end,
                Motion *to) {
    const double k_d = held->mode == STICK ? m->k_d : 0, rub = sign_of(held->mode) * m->mu;
    if (held->mode == APART)
        rk4_in(m, z, a1, h, middle, end, true, 0, true, 0, 0, 0, to);
    else if (held->left_tip)
        rk4_in(m, z, a1, h, middle, end, false, held->upper, true, k_d, held->u_s, rub, to);
    else
        rk4_in(m, z, a1, h, middle, end, false, held->upper, false, k_d, held->u_s, rub, to);
}

INLINE void rates(const Motion *z, const Touch *t, bool left_tip, double *v_rate, double *u_rate) {
    const double *r = z->r, w = left_tip ? r[5] : r[4];
    const double d_x = (r[0] - r[1]) + r[4] * t->l_y - r[5] * t->r_y;
    const double d_y = (r[2] - r[3]) - r[4] * t->l_x + r[5] * t->r_x;
    *v_rate = d_x * t->s_A - d_y * t->c_A - w * t->u;
    *u_rate = d_x * t->c_A + d_y * t->s_A + w * t->v;
}

// The contact of the held case, or while apart of the one that the positions choose, and the violated guards.
INLINE int look(const Model *m, Held *held, const Motion *z, Touch *t) {
    if (held->mode == APART) {
        double s1, w1, s2, w2;
        sine_versine(z->q[4], &s1, &w1);
        sine_versine(z->q[5], &s2, &w2);
        held->upper = z->q[4] > z->q[5];
        const double l0 = m->l0[held->upper], r0 = m->r0[held->upper], y0 = m->y0[held->upper];
        const double height = (z->q[2] - z->q[3]) - y0 * (w1 - w2) - l0 * s1 + r0 * s2;
        held->left_tip = held->upper ? height < 0 : height > 0;
        *t = touch_at(m, z->q, s1, w1, s2, w2, held->upper, held->left_tip);
        return t->v > 0 ? LIFT : 0;
    }
    const double turn = z->q[4] - z->q[5];
    *t = touch(m, z->q, held->upper, held->left_tip);
    int violated = t->v < 0 ? LIFT : 0;
    violated |= (held->upper ? turn < 0 : turn > 0) ? TURN : 0;
    violated |= (held->upper == held->left_tip ? t->e_y > 0 : t->e_y < 0) ? HEIGHT : 0;
    if (held->mode == STICK) {
        violated |= fabs(t->u - held->u_s) - m->lag * t->v > TINY ? LIMIT : 0;
    } else {
        double v_rate, u_rate;
        rates(z, t, held->left_tip, &v_rate, &u_rate);
        violated |= sign_of(held->mode) * u_rate < m->lag * v_rate ? REVERSE : 0;
    }
    return violated;
}

INLINE void first_stage(const Model *m, const Held *held, const Motion *z, const Touch *t, Wave w, double *a) {
    const double k_d = held->mode == STICK ? m->k_d : 0, rub = sign_of(held->mode) * m->mu;
    if (held->mode == APART)
        free_accelerations(m, z->q, z->r, w, a);
    else
        accelerations(m, z->q, z->r, w, t, held->left_tip, k_d, held->u_s, rub, a);
}

// The transition of one guard, crossed at most `late` ago; what else it settles at this instant.
static int change(const Model *m, Held *held, const Motion *z, const Touch *t, int guard, double late) {
    double v_rate, u_rate;
    rates(z, t, held->left_tip, &v_rate, &u_rate);
    switch (guard) {
        case LIFT:
            if (held->mode != APART) {
                held->mode = APART;
                return LIFT;
            }
            held->mode = fabs(u_rate) > m->lag * v_rate ? (u_rate > 0 ? SLIP_PLUS : SLIP_MINUS) : STICK;
            held->u_s = t->u - u_rate * (v_rate > 0 ? fmin(t->v / v_rate, late) : 0);
            return LIFT | LIMIT;
        case LIMIT:
            held->mode = t->u > held->u_s ? SLIP_PLUS : SLIP_MINUS;
            return LIMIT;
        case REVERSE:
            held->u_s = t->u - sign_of(held->mode) * m->lag * t->v;
            held->mode = STICK;
            return REVERSE | LIMIT;
    }
    if (guard == TURN) held->upper = !held->upper;  // 1 <-> 4, 2 <-> 3: the tip's block changes too
    held->left_tip = !held->left_tip;
    held->u_s += touch(m, z->q, held->upper, held->left_tip).u - t->u;
    return guard;
}

// A step of length h from where the drive is at `now`; `end`: where it is then.
INLINE void rk4_from(const Model *m, const Held *held, const Motion *z, const double *a1, double h, Wave now, Wave *end,
                     Motion *to) {
    double s, w;
    sine_versine(m->omega * h / 2, &s, &w);
    const Wave middle = {now.s - now.s * w + now.c * s, now.c - now.c * w - now.s * s};
    *end = (Wave){middle.s - middle.s * w + middle.c * s, middle.c - middle.c * w - middle.s * s};
    rk4(m, held, z, a1, h, middle, *end, to);
}

// A step of length `left` whose end, at `trial`, violates guards: event by event to that end.
static __attribute__((noinline)) void with_events(const Model *m, Held *held, Motion *z, double *a1, Touch *t,
                                                  const Motion *trial, int violated, Wave now, Wave end, double left,
                                                  int bisections) {
    Motion at_high = *trial, at_middle;
    Wave at;
    for (int events = 0; violated && events < MAX_EVENTS; events++) {
        double low = 0, high = left;
        for (int i = 0; i < bisections; i++) {
            const double middle = (low + high) / 2;
            Touch there;
            rk4_from(m, held, z, a1, middle, now, &at, &at_middle);
            const int beyond = look(m, held, &at_middle, &there);
            if (beyond)
                high = middle, at_high = at_middle, end = at, violated = beyond, *t = there;
            else
                low = middle;
        }
        *z = at_high, now = end, left -= high;
        for (int handled = 0; violated &= ~handled;) {
            handled |= change(m, held, z, t, violated & -violated, high - low);
            violated = look(m, held, z, t);
        }
        if (left <= 0) break;
        first_stage(m, held, z, t, now, a1);
        rk4_from(m, held, z, a1, left, now, &end, &at_high);
        violated = look(m, held, &at_high, t);
        if (!violated || events + 1 == MAX_EVENTS) *z = at_high;
    }
}

static void march(const Model *m, int steps, int periods, int bisections, const Wave *waves, double *end) {
    const double h = 2 * M_PI / m->omega / steps;
    Held held = {.mode = APART};
    Motion z = {{0}, {0}}, trial;
    Touch t;
    double a1[6];
    look(m, &held, &z, &t);
    free_accelerations(m, z.q, z.r, waves[0], a1);
    for (int period = 0; period < periods; period++)
        for (int i = 0; i < steps; i++) {
            rk4(m, &held, &z, a1, h, waves[2 * i + 1], waves[2 * i + 2], &trial);
            const int violated = look(m, &held, &trial, &t);
            if (__builtin_expect(violated, 0))
                with_events(m, &held, &z, a1, &t, &trial, violated, waves[2 * i], waves[2 * i + 2], h,
                            bisections);
            else
                z = trial;
            first_stage(m, &held, &z, &t, waves[2 * i + 2], a1);
        }
    for (int i = 0; i < 6; i++) end[i] = z.q[i], end[6 + i] = z.r[i];
}

// All lanes; `waves` is the drive's sine and cosine at half steps of one period, 2 steps + 1 pairs.
void run(const Parameters *p, const double *springs, int lanes, int steps, int periods, int bisections,
         const double *waves, double *ends) {
    Model m = model(p);
    for (int lane = 0; lane < lanes; lane++) {
        m.k = springs[lane];
        m.lag = m.mu * m.k / m.k_d;
        march(&m, steps, periods, bisections, (const Wave *)waves, ends + 12 * lane);
    }
}
