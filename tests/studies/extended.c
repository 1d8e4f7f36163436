/* Two blades from rest in extended precision, by extrapolated midpoint steps: see extended.py.

   The blocks are rigid bodies that push each other with a force at a point. Between events Gragg's midpoint rule is
   extrapolated; the first root of any guard within a step is bracketed and found by Chandrupatla's method on shortened
   steps, without dense output. Faces whose rocking returns within a given time are flat: they move as Filippov's mean
   of contact at the upper and at the lower corner. */

#include <math.h>

typedef long double real;
enum { APART, STICK, SLIP_PLUS, SLIP_MINUS };
enum { TURN, HEIGHT, GAP, RUB, UPPER, GUARDS }; /* UPPER: flat faces tip at their upper corner; at the lower one: TURN */
enum { OK, CROWDED, TURNED };
enum { COLUMNS = 7, HALVINGS = 20, TRIALS = 120, CHANGES = 12 };

/* Cases 1 to 4 are the article's, 5 and 6 flat faces: the cases at whose corners they tip are 1 and 4, or 2 and 3. */
static const int OPPOSITE[] = {0, 4, 3, 2, 1, 4, 3}, BESIDE[] = {0, 2, 1, 4, 3, 6, 5}, FLAT[] = {0, 5, 6, 6, 5};
static const int LOWER[] = {0, 1, 2, 3, 4, 4, 3}, UPPER_OF[] = {0, 1, 2, 3, 4, 1, 2};
static const real SCALES[] = {1e-4L, 1e-5L, 1e-5L, 1e-2L, 1e-4L}; /* of the guards, for the order of two that are near */
static const real TINY[] = {1e-19L, 2e-20L, 2e-20L, 1e-16L, 1e-19L}; /* roundings of the guards */
static const real LENGTH = 0.3L;            /* of a step, times the largest angular frequency */
static const real LIMITS[] = {0.004L, 0.02L, 0.06L, 0.15L}; /* up to which 3, 4, 5, 6 columns are enough */
static const real LEAST_SHARE = 1.0L / 64, NEAR = 0.05L, LOCATED = 1e-17L;

typedef struct { /* x, y, theta of both blades, then of contact */
    double m[6], k[6], c[6], F[6], phase[2], omega, alpha, l_oa, l_ab, gap, k_n, k_d, mu;
} Numbers;

typedef struct {
    Numbers p;
    real sine, cosine, reach[3], fastest, flat;
    real t, z[12], u_s;
    int mode, face, handled[GUARDS];
    long switches, events;
} Lane;

typedef struct { /* corners that touch: levers [blade][x, y], from the right one's to the left one's, face, v and u */
    real lever[2][2], d[2], s, c, v, u, v_rate, u_rate;
} Corners;

static Corners corners(const Lane *a, int face, const real *z) {
    Corners r;
    int upper = face <= 2, of_left = face == 1 || face == 3;
    real height = upper ? a->reach[2] : -a->reach[2], moved[2][2], sine[2], versed[2];
    for (int i = 0; i < 2; i++) {
        real half_s = sinl(z[4 + i] / 2), half_c = cosl(z[4 + i] / 2), x = upper == (i == 0) ? a->reach[0] : a->reach[1];
        if (i) x = -x;
        sine[i] = 2 * half_s * half_c, versed[i] = 2 * half_s * half_s;
        moved[i][0] = height * sine[i] - x * versed[i], moved[i][1] = -x * sine[i] - height * versed[i];
        r.lever[i][0] = x + moved[i][0], r.lever[i][1] = height + moved[i][1];
    }
    r.d[0] = z[0] - z[1] + moved[0][0] - moved[1][0] - a->p.gap;
    r.d[1] = z[2] - z[3] + moved[0][1] - moved[1][1];
    real dx = z[6] - z[7] + r.lever[0][1] * z[10] - r.lever[1][1] * z[11];
    real dy = z[8] - z[9] - r.lever[0][0] * z[10] + r.lever[1][0] * z[11];
    real s = sine[of_left], v = versed[of_left], turn = -z[10 + of_left];
    r.s = a->sine - a->sine * v - a->cosine * s, r.c = a->cosine - a->cosine * v + a->sine * s;
    r.v = r.d[0] * r.s - r.d[1] * r.c, r.u = r.d[0] * r.c + r.d[1] * r.s;
    r.v_rate = dx * r.s - dy * r.c + r.u * turn, r.u_rate = dx * r.c + dy * r.s - r.v * turn;
    return r;
}

static int sigma(int mode) { return (mode == SLIP_PLUS) - (mode == SLIP_MINUS); }

static void add_contact(const Lane *a, int face, const real *z, real *load) {
    Corners r = corners(a, face, z);
    int of_left = face == 1 || face == 3;
    real N = a->p.k_n * r.v, F = a->mode == STICK ? a->p.k_d * (r.u - a->u_s) : sigma(a->mode) * a->p.mu * N;
    real x = -N * r.s - F * r.c, y = N * r.c - F * r.s;
    load[0] += x, load[1] -= x, load[2] += y, load[3] -= y;
    for (int i = 0; i < 2; i++) { /* moments, clockwise, of the force at the corner that touches the other's face */
        real at_x = r.lever[i][0], at_y = r.lever[i][1], other = i ? of_left : !of_left, side = i ? 1 : -1;
        at_x += other * side * r.d[0], at_y += other * side * r.d[1];
        load[4 + i] -= side * (at_y * x - at_x * y);
    }
}

static void drive(const Lane *a, real t, const real *z, real *load) {
    real wave[2] = {sinl(a->p.omega * t + a->p.phase[0]), sinl(a->p.omega * t + a->p.phase[1])};
    for (int i = 0; i < 6; i++) load[i] = a->p.F[i] * wave[i % 2] - a->p.k[i] * z[i] - a->p.c[i] * z[6 + i];
}

static real turning(const Lane *a, const real *load) { return load[4] / a->p.m[4] - load[5] / a->p.m[5]; }

/* The accelerations of the relative angle with contact at either corner, and the loads. */
static void tips(const Lane *a, int face, real t, const real *z, real load[2][6], real *turns) {
    drive(a, t, z, load[0]);
    for (int i = 0; i < 6; i++) load[1][i] = load[0][i];
    for (int j = 0; j < 2; j++) {
        add_contact(a, j ? LOWER[face] : UPPER_OF[face], z, load[j]);
        turns[j] = turning(a, load[j]);
    }
}

static void rates(const Lane *a, real t, const real *z, real *out) {
    real load[2][6], turns[2];
    if (a->face > 4 && a->mode != APART) {
        tips(a, a->face, t, z, load, turns);
        real share = turns[1] / (turns[1] - turns[0]);
        for (int i = 0; i < 6; i++) load[0][i] = load[1][i] + share * (load[0][i] - load[1][i]);
    } else {
        drive(a, t, z, load[0]);
        if (a->mode != APART) add_contact(a, a->face, z, load[0]);
    }
    for (int i = 0; i < 6; i++) out[i] = z[6 + i], out[6 + i] = load[0][i] / a->p.m[i];
}

/* Functions that rise through zero where the case or the mode ends. */
static void guards(const Lane *a, real t, const real *z, real *g) {
    int face = a->face, flat = face > 4 && a->mode != APART;
    Corners r = corners(a, LOWER[face], z);
    real ahead = z[4] - z[5], most = a->p.mu * a->p.k_n / a->p.k_d, load[2][6], turns[2];
    g[TURN] = face <= 2 ? -ahead : ahead;
    g[HEIGHT] = face == 1 || face == 4 || face == 5 ? r.d[1] : -r.d[1];
    g[GAP] = a->mode == APART ? r.v : -r.v;
    g[RUB] = a->mode == STICK ? (fabsl(r.u - a->u_s) - most * r.v) * 1000 : most * r.v_rate - sigma(a->mode) * r.u_rate;
    g[UPPER] = -1;
    if (a->mode == APART) g[RUB] = -1;
    if (!flat) return;
    tips(a, face, t, z, load, turns);
    g[UPPER] = 1e-8L * turns[0], g[TURN] = -1e-8L * turns[1];
}

static void stepped(const Lane *a, real h, real *end, real *middle) {
    real table[COLUMNS][12], first[12], f[12], old[12], now[12], size = h * a->fastest;
    int columns = 3;
    while (columns < COLUMNS && size > LIMITS[columns - 3]) columns++;
    rates(a, a->t, a->z, first);
    for (int j = 0; j < columns; j++) {
        int n = 2 * (j + 1);
        real part = h / n;
        for (int i = 0; i < 12; i++) old[i] = a->z[i], now[i] = old[i] + part * first[i];
        for (int l = 1; l < n; l++) {
            if (2 * l == n)
                for (int i = 0; i < 12; i++) middle[i] = now[i];
            rates(a, a->t + l * part, now, f);
            for (int i = 0; i < 12; i++) {
                real next = old[i] + 2 * part * f[i];
                old[i] = now[i], now[i] = next;
            }
        }
        for (int i = 0; i < 12; i++) { /* Aitken and Neville, in place: table[l] is of order 2 (l + 1) */
            real before = table[0][i], kept;
            table[0][i] = now[i];
            for (int l = 1; l <= j; l++) {
                real ratio = (real)n / (n - 2 * l);
                kept = l < j ? table[l][i] : 0;
                table[l][i] = table[l - 1][i] + (table[l - 1][i] - before) / (ratio * ratio - 1);
                before = kept;
            }
        }
    }
    for (int i = 0; i < 12; i++) end[i] = table[columns - 1][i];
}

/* The highest guard that may end the step, over its scale. */
static real level(const real *g, const int *allowed, int *kind) {
    real top = -INFINITY;
    for (int i = 0; i < GUARDS; i++)
        if (allowed[i] && g[i] / SCALES[i] > top) top = g[i] / SCALES[i], *kind = i;
    return top;
}

/* Whether a parabola through a guard at three places of a step comes near zero between them. */
static int hides(const real *start, const real *middle, const real *end, const int *zero) {
    for (int i = 0; i < GUARDS; i++) {
        real bend = start[i] - 2 * middle[i] + end[i], lean = start[i] - end[i];
        if (zero[i]) continue;
        if (middle[i] > 0) return 1;
        if (bend < 0 && fabsl(lean) < -2 * bend && middle[i] - lean * lean / (8 * bend) > NEAR * bend) return 1;
    }
    return 0;
}

/* Chandrupatla's next place in the bracket from x[0], the newest, to x[1]; x[2] was before. */
static real next_place(const real *x, const real *f, real h) {
    real xi = (x[0] - x[1]) / (x[2] - x[1]), phi = (f[0] - f[1]) / (f[2] - f[1]), part = 0.5L;
    if (phi * phi < xi && (1 - phi) * (1 - phi) < 1 - xi)
        part = f[0] / (f[1] - f[0]) * f[2] / (f[1] - f[2]) +
               (x[2] - x[0]) / (x[1] - x[0]) * f[0] / (f[2] - f[0]) * f[1] / (f[2] - f[1]);
    real least = fminl(LOCATED * h / (2 * fabsl(x[1] - x[0])), 0.5L);
    if (!(part > least)) part = least;
    if (part > 1 - least) part = 1 - least;
    return x[0] + part * (x[1] - x[0]);
}

/* The place of the event between a place with none (f < 0, or NAN where guards start at zero) and one beyond. */
static real located(const Lane *a, real h, real before, real f_h, const int *allowed, real *z, int *kind) {
    real x[3] = {h, 0, 0}, f[3] = {f_h, before, before}, trial[12], middle[12], g[GUARDS];
    real newton = NAN; /* of the angles' difference, whose rate is known */
    for (int n = 0; n < TRIALS; n++) {
        int which = 0, unknown = isnan(f[1]);
        if (!unknown && fabsl(x[1] - x[0]) <= LOCATED * h) break;
        if (unknown && n > HALVINGS) {
            for (int i = 0; i < 12; i++) z[i] = a->z[i];
            return 0;
        }
        int rocks = *kind == TURN && a->face <= 4, inside = newton > fminl(x[0], x[1]) && newton < fmaxl(x[0], x[1]);
        real at = rocks && inside ? newton : unknown ? x[0] / 2 : next_place(x, f, h);
        stepped(a, at, trial, middle);
        newton = at - (trial[4] - trial[5]) / (trial[10] - trial[11]);
        guards(a, a->t + at, trial, g);
        real now = level(g, allowed, &which);
        if (now == 0) now = 1e-4000L;
        if (now > 0) {
            *kind = which;
            for (int i = 0; i < 12; i++) z[i] = trial[i];
            if (rocks && which == TURN && fabsl(newton - at) <= LOCATED * h) return at;
        }
        if (unknown) {
            if (now > 0) x[0] = at, f[0] = now;
            else x[2] = x[1] = at, f[2] = f[1] = now;
            continue;
        }
        if ((now > 0) == (f[0] > 0)) x[2] = x[0], f[2] = f[0];
        else x[2] = x[1], f[2] = f[1], x[1] = x[0], f[1] = f[0];
        x[0] = at, f[0] = now;
    }
    return fmaxl(x[0], x[1]);
}

/* Faces become flat where a rocking would return within the time for that on either side; its motion ends. */
static void flatten(Lane *a) {
    real load[2][6], turns[2], speed = fabsl(a->z[10] - a->z[11]), *m = (real[2]){a->p.m[4], a->p.m[5]};
    tips(a, FLAT[a->face], a->t, a->z, load, turns);
    if (!(2 * speed < -turns[0] * a->flat && 2 * speed < turns[1] * a->flat)) return;
    a->face = FLAT[a->face];
    for (int i = 4; i <= 10; i += 6) a->z[i] = a->z[i + 1] = (m[0] * a->z[i] + m[1] * a->z[i + 1]) / (m[0] + m[1]);
}

static void change(Lane *a, int kind) {
    Corners r = corners(a, LOWER[a->face], a->z);
    real most = a->p.mu * a->p.k_n, stretch = r.u - a->u_s;
    int apart = a->mode == APART, was_flat = a->face > 4;
    a->handled[kind] = 1;
    if (kind == TURN || kind == HEIGHT || kind == UPPER) {
        a->face = kind == UPPER ? UPPER_OF[a->face] : kind == TURN ? OPPOSITE[a->face] : BESIDE[a->face];
        if (!apart) a->switches++;
        if (a->mode == STICK) a->u_s = corners(a, LOWER[a->face], a->z).u - stretch;
        if (kind == TURN && !apart && !was_flat) flatten(a);
        if (kind != HEIGHT) a->handled[TURN] = a->face <= 4, a->handled[UPPER] = 0;
        return;
    }
    a->events++;
    if (kind == GAP && apart) {
        int slips = a->p.k_d * fabsl(r.u_rate) > most * r.v_rate;
        a->u_s = r.u, a->mode = !slips ? STICK : r.u_rate > 0 ? SLIP_PLUS : SLIP_MINUS;
    } else if (kind == GAP) {
        a->mode = APART, a->u_s = 0;
        if (was_flat) a->face = LOWER[a->face], a->handled[TURN] = 1;
    } else if (a->mode == STICK) {
        if (fabsl(stretch) <= TINY[GAP]) stretch = r.u_rate;
        a->mode = stretch > 0 ? SLIP_PLUS : SLIP_MINUS;
    } else {
        a->u_s = r.u - sigma(a->mode) * most / a->p.k_d * r.v, a->mode = STICK;
    }
    a->handled[RUB] = a->mode == STICK;
}

static void change_all(Lane *a, int kind) {
    real g[GUARDS];
    for (int n = 0; n < CHANGES && kind >= 0; n++) {
        change(a, kind);
        guards(a, a->t, a->z, g);
        kind = -1;
        for (int i = GUARDS - 1; i >= 0; i--)
            if (g[i] > TINY[i] && !a->handled[i]) kind = i;
    }
}

/* The time in which faces that have just passed each other would do so again; h where that is longer. */
static real first_return(const Lane *a, real h) {
    real f[12];
    if (!a->handled[TURN] || a->mode == APART || a->face > 4) return h;
    rates(a, a->t, a->z, f);
    real back = 2 * fabsl((a->z[10] - a->z[11]) / (f[10] - f[11]));
    return back > 0 && 1.02L * back < h ? 1.02L * back : h;
}

/* One step, of at most h, to its end or to the first event. */
static void advance(Lane *a, real h, real longest) {
    real start[GUARDS], end[GUARDS], between[GUARDS], z[12], middle[12];
    int zero[GUARDS], allowed[GUARDS], kind = 0, from_zero = 0;
    guards(a, a->t, a->z, start);
    for (;; h /= 2) {
        stepped(a, h, z, middle);
        guards(a, a->t + h, z, end);
        for (int i = 0; i < GUARDS; i++) {
            zero[i] = a->handled[i] || fabsl(start[i]) <= TINY[i];
            allowed[i] = !zero[i] || end[i] > TINY[i];
        }
        real now = level(end, allowed, &kind);
        if (now >= 0) {
            for (int i = 0; i < GUARDS; i++) from_zero |= allowed[i] && zero[i];
            int first = 0;
            real before = from_zero ? NAN : level(start, allowed, &first);
            real at = located(a, h, before, now > 0 ? now : 1e-4000L, allowed, z, &kind);
            for (int i = 0; i < 12; i++) a->z[i] = z[i];
            a->t += at;
            if (at > 0)
                for (int i = 0; i < GUARDS; i++) a->handled[i] = 0;
            change_all(a, kind);
            return;
        }
        guards(a, a->t + h / 2, middle, between);
        if (h <= LEAST_SHARE * longest || !hides(start, between, end, zero)) break;
    }
    a->t += h;
    for (int i = 0; i < 12; i++) a->z[i] = z[i];
    for (int i = 0; i < GUARDS; i++) a->handled[i] = 0;
}

/* March from rest; out: the states at the ends of periods (periods, 12); counts: case switches, other events. */
int march(const Numbers *numbers, int periods, double fineness, double flat, long most, real *out, long *counts) {
    Lane a = {.p = *numbers, .flat = flat, .mode = APART, .face = 4};
    const Numbers *p = &a.p;
    real alpha = p->alpha, own = 0, soft = 0;
    a.sine = sinl(alpha), a.cosine = cosl(alpha);
    a.reach[0] = p->l_oa / 2 + p->l_ab * a.cosine / 2, a.reach[1] = p->l_oa / 2 - p->l_ab * a.cosine / 2;
    a.reach[2] = p->l_ab * a.sine / 2;
    for (int i = 0; i < 6; i++) {
        own = fmaxl(own, p->k[i] / (real)p->m[i]);
        soft += (i < 4 ? 0.5L : a.reach[0] * a.reach[0] + a.reach[2] * a.reach[2]) / p->m[i];
    }
    a.fastest = sqrtl(own + (p->k_n + p->k_d) * soft);
    real longest = fineness * LENGTH / a.fastest;
    for (int n = 0; n < periods; n++) {
        real end = 2 * acosl(-1) * (n + 1) / p->omega;
        while (a.t < end) {
            real left = end - a.t, h = first_return(&a, longest);
            int last = left < 1.01L * h;
            long before = a.switches + a.events;
            real began = a.t;
            advance(&a, last ? left : h, longest);
            if (last && a.switches + a.events == before && a.t - began >= left * (1 - 1e-15L)) a.t = end;
            counts[0] = a.switches, counts[1] = a.events;
            if (a.switches + a.events > most) return CROWDED;
            if (fabsl(a.z[4]) > 0.785L || fabsl(a.z[5]) > 0.785L) return TURNED;
        }
        for (int i = 0; i < 12; i++) out[12 * n + i] = a.z[i];
    }
    return OK;
}
