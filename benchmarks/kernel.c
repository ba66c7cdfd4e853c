/* The fit's simulation kernel in plain C, for the models of kernel.py: dry friction with stick, a winding that lags,
 * Stribeck friction, cogging torque, play before a second inertia, a second inertia on a spring.
 *
 * The algorithm is that of fiohost/motor: exact flow between events, what depends on the state taken in the predicted
 * middle of a sub-step, the first event on the way located on the flow itself, exponentials kept from step to step.
 * Left out is what these models lack: ends of travel, bristles, effects with a state of their own, losses and limits of
 * the current, an open bridge, loads beyond the gap, changes of the plant. Degrees, seconds, percent of duty.
 */
#include <math.h>
#include <stdbool.h>
#include <string.h>

/* What is inlined and what is called is as in the kernel; left to itself gcc calls all, at twice the time. */
#define ALIKE 1e-9
#define INLINED static inline __attribute__((always_inline))
#define APART static __attribute__((noinline))
#define MOST_STEPS 400
#define LOOKS 80
#define OPEN_GAP_S 1e-3
#define SURE_S 1e-12
#define SAME_TIME_S 1e-12
#define ALIKE 1e-9
#define N 4
#define SHORT 0.5
#define TERMS 14

enum { RIGID, PLAY, SPRING };
enum { REST, TOUCH, PARTING, RELEASE };

/* As kernel.py hands it over; what a model lacks is zero, and pulse is the resonance in rad/s. */
typedef struct {
    double gain, tau, dry, lag, extra, stribeck_speed, gaussian, order, level, phase, gap, share, pulse, damping;
} Model;

typedef struct { double theta, omega, load_theta, load_omega, contact, amps; } State;
typedef struct { double turn, omega, amps, twist, load_omega; } Motion;
typedef struct { int kind; double half_gap, mass, own, other, stiff, damp; } Bodies;
typedef struct { bool joined, stuck; double volts, force; } Regime;

/* Exponentials of one length of step: of one body, and of two on a spring with both integrals. */
typedef struct {
    double dt, tau, first, second;
    double dt2, held, e[N][N], integral[N][N], twice[N][N];
} Kept;

static double sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : 0.0; }

/* exp(a dt) cosh(b dt) and exp(a dt) sinh(b dt) / b for the poles a +- b of current and speed. */
static void swing(double dt, double tau, double lag, double *c, double *s)
{
    double a = -0.5 / lag, square = a * a - 1.0 / (tau * lag), fallen = exp(a * dt);
    if (square > 1e-6 * a * a) {
        double b = sqrt(square), fast = exp((a - b) * dt), slow = exp((a + b) * dt);
        *c = 0.5 * (slow + fast), *s = 0.5 * (slow - fast) / b;
    } else if (square < -1e-6 * a * a) {
        double b = sqrt(-square);
        *c = fallen * cos(b * dt), *s = fallen * sin(b * dt) / b;
    } else {
        *c = fallen, *s = fallen * dt;
    }
}

INLINED void one_body(const Model *m, Motion *x, const Regime *r, double tau, double dt, Kept *kept)
{
    if (fabs(dt - kept->dt) > SURE_S || tau != kept->tau) {
        kept->dt = dt, kept->tau = tau;
        if (m->lag == 0.0)
            kept->first = expm1(-dt / tau);
        else
            swing(dt, tau, m->lag, &kept->first, &kept->second);
    }
    double steady = m->gain * (r->volts + r->force);
    if (m->lag == 0.0) {
        double change = (x->omega - steady) * kept->first;
        x->turn = steady * dt - tau * change;
        x->omega += change;
        x->amps = r->volts - x->omega / m->gain;
        return;
    }
    double c = kept->first, s = kept->second, half = 0.5 / m->lag;
    double w = (x->omega - steady) / m->gain, v = x->amps + r->force;
    double w1 = (c + half * s) * w + s / tau * v, v1 = (c - half * s) * v - s / m->lag * w;
    x->turn = steady * dt - m->gain * (m->lag * (v1 - v) + tau * (w1 - w));
    x->omega = steady + m->gain * w1;
    x->amps = v1 - r->force;
}

static void times(double a[N][N], double b[N][N], double to[N][N])
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double total = 0.0;
            for (int k = 0; k < N; k++)
                total += a[i][k] * b[k][j];
            to[i][j] = total;
        }
}

/* exp(A t), its integral and the integral of that: a series over a short time, then doubled. */
static void propagate(double a[N][N], double dt, Kept *kept)
{
    double size = 0.0, h = dt, term[N][N], spare[N][N];
    int doublings = 0;
    for (int i = 0; i < N; i++) {
        double row = 0.0;
        for (int j = 0; j < N; j++)
            row += fabs(a[i][j]);
        size = fmax(size, row);
    }
    for (; size * h > SHORT; doublings++)
        h *= 0.5;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double unit = i == j ? 1.0 : 0.0;
            term[i][j] = kept->e[i][j] = unit;
            kept->integral[i][j] = unit * h, kept->twice[i][j] = unit * 0.5 * h * h;
        }
    for (int k = 1; k < TERMS; k++) {
        times(a, term, spare);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                double total = spare[i][j] * h / k;
                term[i][j] = total;
                kept->e[i][j] += total;
                kept->integral[i][j] += total * h / (k + 1);
                kept->twice[i][j] += total * h * h / ((k + 1) * (k + 2));
            }
    }
    for (; doublings > 0; doublings--, h *= 2.0) {
        times(kept->e, kept->twice, term);
        times(kept->e, kept->integral, spare);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                kept->twice[i][j] += term[i][j] + h * kept->integral[i][j];
                kept->integral[i][j] += spare[i][j];
            }
        times(kept->e, kept->e, term);
        memcpy(kept->e, term, sizeof term);
    }
}

APART void two_bodies(const Model *m, const Bodies *b, Motion *x, const Regime *r, double dt, Kept *kept)
{
    double held = r->stuck ? 1.0 : 2.0;
    if (fabs(dt - kept->dt2) > SURE_S || held != kept->held) {
        kept->dt2 = dt, kept->held = held;
        double a[N][N] = {{0}};
        if (!r->stuck) {
            a[0][0] = -b->damp / b->own, a[0][2] = -b->stiff / b->own, a[0][3] = b->damp / b->own;
            if (m->lag > 0.0)
                a[0][1] = 1.0 / b->own;
            else
                a[0][0] -= 1.0 / (m->gain * b->own);
        }
        if (m->lag > 0.0)
            a[1][0] = -1.0 / (m->gain * m->lag), a[1][1] = -1.0 / m->lag;
        a[2][0] = 1.0, a[2][3] = -1.0;
        a[3][0] = b->damp / b->other, a[3][2] = b->stiff / b->other, a[3][3] = -b->damp / b->other;
        propagate(a, dt, kept);
    }
    double in[N] = {x->omega, x->amps, x->twist, x->load_omega}, out[N], turn = 0.0;
    double pushed[2] = {r->stuck ? 0.0 : (m->lag > 0.0 ? r->force : r->force + r->volts) / b->own,
                        m->lag > 0.0 ? r->volts / m->lag : 0.0};
    for (int i = 0; i < N; i++) {
        out[i] = kept->integral[i][0] * pushed[0] + kept->integral[i][1] * pushed[1];
        for (int j = 0; j < N; j++)
            out[i] += kept->e[i][j] * in[j];
        turn += kept->integral[0][i] * in[i];
    }
    x->turn = turn + kept->twice[0][0] * pushed[0] + kept->twice[0][1] * pushed[1];
    x->omega = out[0], x->twist = out[2], x->load_omega = out[3];
    x->amps = m->lag > 0.0 ? out[1] : r->volts - out[0] / m->gain;
}

INLINED Motion flow(const Model *m, const Bodies *b, Motion x, const Regime *r, double h, Kept *kept)
{
    if (b->kind == SPRING) {
        two_bodies(m, b, &x, r, h, kept);
        return x;
    }
    if (r->stuck) {
        x.turn = x.omega = 0.0;
        x.amps = r->volts + (m->lag > 0.0 ? (x.amps - r->volts) * exp(-h / m->lag) : 0.0);
    } else {
        one_body(m, &x, r, m->gain * (r->joined ? b->mass : b->own), h, kept);
    }
    if (r->joined)
        x.load_omega = x.omega;
    else
        x.twist += x.turn - x.load_omega * h;
    return x;
}

/* How far the end of a step is from the nearest event (below 0: beyond it), and which. */
INLINED double judge(const Bodies *b, const Motion *end, double omega, double began, const Regime *r, double lag,
                     double contact, double direction, double hold, double torque, int *event)
{
    double found = INFINITY;
    *event = REST;
    if (omega != 0.0 && !r->stuck)
        found = end->omega * direction;
    if (b->kind == PLAY && !r->joined) {
        double gap = b->half_gap * (1.0 + ALIKE) - fabs(end->twist);
        if (gap < found && (end->omega - end->load_omega) * end->twist > 0.0)
            found = gap, *event = TOUCH;
    } else if (b->kind == PLAY && !r->stuck) {
        /* What is taken in the middle may have them apart at the beginning: then the next step begins with that. */
        double apart = contact * (end->amps + r->force) / b->own, tiny = ALIKE * fabs(r->force) / b->own;
        if (apart < fmin(found, -tiny) && contact * (began + r->force) / b->own > -tiny)
            found = apart, *event = PARTING;
    }
    if (r->stuck && (lag > 0.0 || b->kind == SPRING)) {
        double pull = end->amps + torque;
        if (b->kind == SPRING)
            pull -= b->stiff * end->twist + b->damp * (end->omega - end->load_omega);
        if (hold - fabs(pull) < found)
            found = hold - fabs(pull), *event = RELEASE;
    }
    return found;
}

static void advance(const Model *m, const Bodies *b, State *x, double duty, double span, double substep, Kept kept[3])
{
    bool released = false;
    double left = span;
    for (int n = 0; n < MOST_STEPS && left > SAME_TIME_S; n++) {
        Regime r = {.joined = b->kind == RIGID || (b->kind == PLAY && x->contact != 0.0), .volts = duty};
        Motion begin = {0.0, x->omega, x->amps, b->kind == RIGID ? 0.0 : x->theta - x->load_theta,
                        r.joined ? x->omega : x->load_omega};
        Motion now = begin;
        double h = substep > 0.0 && n < MOST_STEPS - 1 ? left / fmax(ceil(left / substep - ALIKE), 1.0) : left;
        if (b->kind == PLAY && !r.joined && h > OPEN_GAP_S)
            h = OPEN_GAP_S;
        double direction = sign(x->omega), hold = 0.0, torque = 0.0;
        bool parts = false;
        for (int middle = 0; middle < 2; middle++) {
            double push = m->lag > 0.0 ? now.amps : duty - now.omega / m->gain;
            if (middle == 0)
                begin.amps = push;
            torque = 0.0;
            if (m->level != 0.0)
                torque = -m->level * sin((m->order * (x->theta + now.turn) + m->phase) * (M_PI / 180.0));
            double total = push + torque, level = m->dry;
            if (b->kind == SPRING)
                total -= b->stiff * now.twist + b->damp * (now.omega - now.load_omega);
            if (m->extra != 0.0) {
                double ratio = fabs(now.omega) / m->stribeck_speed;
                level += m->extra * exp(m->gaussian != 0.0 ? -ratio * ratio : -ratio);
            }
            if (direction == 0.0)
                direction = total > 0.0 ? 1.0 : -1.0;
            if (middle == 0) {
                hold = level;
                r.stuck = x->omega == 0.0 && !(released || fabs(total) > hold);
                if (b->kind == PLAY && r.joined) {
                    /* In contact they stay together unless each by itself would go its own way. */
                    double alone = push + torque;
                    if (x->omega == 0.0 && fabs(alone) <= hold)
                        alone = 0.0;
                    else
                        alone -= level * sign(x->omega != 0.0 ? x->omega : alone);
                    parts = x->contact * alone < -ALIKE * fabs(alone);
                }
            }
            r.force = torque - level * direction;
            if (parts || middle == 1 || substep <= 0.0)
                break;
            now = flow(m, b, begin, &r, 0.5 * h, &kept[1]);
            if (now.omega * direction < 0.0)
                now.omega = 0.0;
        }
        if (parts) {
            x->contact = 0.0;
            continue;
        }

        Motion end = flow(m, b, begin, &r, h, &kept[0]);
        if (x->omega == 0.0 && !r.stuck && end.omega * direction <= 0.0) {
            r.stuck = true;
            end = flow(m, b, begin, &r, h, &kept[0]);
        }
        int event;
        double found = judge(b, &end, x->omega, begin.amps, &r, m->lag, x->contact, direction, hold, torque, &event);
        bool happens = found < 0.0 && n < MOST_STEPS - 1;
        if (happens) {
            /* A false position that halves now and then; the first rest without lag in closed form. */
            double low = 0.0, high = h, before = INFINITY, beyond = found;
            bool simple = m->lag == 0.0 && b->kind != SPRING;
            for (int look = 0; look < LOOKS && high - low > SURE_S; look++) {
                if (look == 0 && event == REST && simple) {
                    double net = m->gain * (duty + r.force), tau = m->gain * (r.joined ? b->mass : b->own);
                    h = fmin(fmax(-tau * log1p(-x->omega / (x->omega - net)), 0.0), high);
                } else if (before == INFINITY || look % 3 == 2) {
                    h = 0.5 * (low + high);
                } else {
                    h = low + (high - low) * before / (before - beyond);
                    h = fmin(fmax(h, low + 1e-3 * (high - low)), high - 1e-3 * (high - low));
                }
                int which;
                Motion trial = flow(m, b, begin, &r, h, &kept[2]);
                double there =
                    judge(b, &trial, x->omega, begin.amps, &r, m->lag, x->contact, direction, hold, torque, &which);
                if (look == 0 && event == REST && simple && fabs(there) <= ALIKE * fabs(x->omega)) {
                    end = trial, high = h;
                    break;
                }
                if (there < 0.0)
                    high = h, beyond = there, end = trial, event = which;
                else
                    low = h, before = there;
            }
            h = high;
        }
        x->theta += end.turn, x->omega = end.omega, x->load_omega = end.load_omega, x->amps = end.amps;
        if (b->kind != RIGID)
            x->load_theta = x->theta - end.twist;
        released = happens && event == RELEASE;
        if (happens && event == REST) {
            x->omega = 0.0;
            if (r.joined)
                x->load_omega = 0.0;
        } else if (happens && event == TOUCH) {
            x->contact = sign(end.twist);
            x->load_theta = x->theta - x->contact * b->half_gap;
            x->omega = x->load_omega = (b->own * end.omega + b->other * end.load_omega) / b->mass;
        } else if (happens && event == PARTING) {
            x->contact = 0.0;
        }
        left -= h;
    }
}

/* States at all of n times from that at the first; duties[j + 1] acts from acts[j] on, duties[0] before. */
void simulate(const Model *m, const double *at, long n, const double *acts, long m_acts, const double *duties,
              double substep, State state, State *states)
{
    double mass = m->tau / m->gain, both = m->share * (1.0 - m->share) * mass;
    Bodies b = {.half_gap = 0.5 * m->gap, .mass = mass, .own = mass * (1.0 - m->share), .other = mass * m->share,
                .stiff = both * m->pulse * m->pulse, .damp = 2.0 * both * m->damping * m->pulse};
    b.kind = m->share == 0.0 ? RIGID : m->pulse > 0.0 ? SPRING : PLAY;
    Kept kept[3] = {0};
    double now = at[0];
    long j = 0;
    while (j < m_acts && acts[j] <= now)
        j++;
    states[0] = state;
    for (long k = 1; k < n; k++) {
        while (now < at[k]) {
            bool changes = j < m_acts && acts[j] < at[k];
            double until = changes ? fmax(acts[j], now) : at[k];
            if (until - now > SAME_TIME_S)
                advance(m, &b, &state, duties[j], until - now, substep, kept);
            now = until;
            if (changes)
                j++;
        }
        states[k] = state;
    }
}
