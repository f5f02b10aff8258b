/*
 * The 6-DOF model  M nu_dot + C(nu) nu + D(nu) nu + g(eta) = tau + tau_0  (Fossen 2021, 6.1), C99 and C++, math.h only.
 *
 * SI; body frame FRD (x forward, y to starboard, z down), world NED. nu = [u v w p q r] is the velocity relative to the
 * water; q = [w x y z] the unit quaternion from body to NED; tau = [X Y Z K M N] about the body's origin.
 *
 *     tt_parameters parameters = tt_default_parameters();
 *     tt_model model;
 *     if (tt_prepare(&parameters, &model) != 0) ...        the mass matrix is not positive definite
 *     tt_forward_dynamics(&model, q, nu, tau, nu_dot);
 *
 * Nothing is allocated and nothing global is written: all functions may be called from several threads.
 */
#ifndef TT_H
#define TT_H

#include <math.h>

typedef @real@ tt_real;

enum { TT_STATES = 13, TT_THRUSTERS = @thrusters@, TT_COLUMNS = @columns@ };

/* Mass, inertia about the centre of gravity, centre of gravity, and every coefficient by its SNAME name:
 * X_udot added mass (negative), X_u linear and X_uu quadratic damping, X_0 a constant wrench, Y_uv a term in u v,
 * X_u2 asymmetric drag, W_minus_B [N], BG_x .. = r_G W - r_B B [N m/rad], inflow_loss [s/m]. Added mass is symmetric. */
typedef struct {
@fields@
} tt_parameters;

static inline tt_parameters tt_default_parameters(void)
{
    tt_parameters p;
@values@
    return p;
}

/* What the functions below work with: tt_prepare makes it of the parameters. */
typedef struct {
    tt_real M[6][6];        /* total mass matrix M_RB + M_A */
    tt_real inverse[6][6];  /* its inverse */
    tt_real linear[6][6];   /* force += linear[i][j] nu[j] */
    tt_real quadratic[6][6];/* force += quadratic[i][j] |nu[j]| nu[j] */
    tt_real forward[6][6];  /* force += u forward[i][j] nu[j] */
    tt_real asymmetry[6];   /* force += asymmetry[i] nu[i]^2 */
    tt_real constant[6];    /* wrench fixed in the body */
    tt_real moment[3];      /* r_G W - r_B B */
    tt_real weight;         /* W - B */
    tt_real inflow_loss;    /* share of the thrust lost per m/s of inflow */
} tt_model;

static inline tt_real tt_absolute(tt_real x) { return @fabs@(x); }

/* The model of parameters; 0 where it is good, 1 where the mass matrix is not positive definite (nothing is written). */
static inline int tt_prepare(const tt_parameters *p, tt_model *model)
{
    const tt_real zero = (tt_real)0;
    const tt_real added[6][6] = {
@added@
    };
    const tt_real linear[6][6] = {
@linear@
    };
    const tt_real quadratic[6][6] = {
@quadratic@
    };
    const tt_real rotating[3][3] = { { p->I_x, p->I_xy, p->I_xz }, { p->I_xy, p->I_y, p->I_yz }, { p->I_xz, p->I_yz, p->I_z } };
    const tt_real S[3][3] = { { zero, -p->z_G, p->y_G }, { p->z_G, zero, -p->x_G }, { -p->y_G, p->x_G, zero } };
    tt_model out;
    tt_real lower[6][6];
    int i, j, k;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            tt_real steiner = zero;
            for (k = 0; k < 3; k++) {
                steiner += S[i][k] * S[k][j];
            }
            out.M[i][j] = i == j ? p->m : zero;
            out.M[i][3 + j] = -p->m * S[i][j];
            out.M[3 + i][j] = p->m * S[i][j];
            out.M[3 + i][3 + j] = rotating[i][j] - p->m * steiner;
        }
    }
    for (i = 0; i < 6; i++) {
        for (j = 0; j < 6; j++) {
            out.M[i][j] -= i <= j ? added[i][j] : added[j][i];
            out.linear[i][j] = linear[i][j];
            out.quadratic[i][j] = quadratic[i][j];
            out.forward[i][j] = zero;
        }
    }
    /* Cholesky, then a column of the inverse at a time */
    for (i = 0; i < 6; i++) {
        for (j = 0; j <= i; j++) {
            tt_real sum = out.M[i][j];
            for (k = 0; k < j; k++) {
                sum -= lower[i][k] * lower[j][k];
            }
            if (i == j) {
                if (!(sum > zero)) {
                    return 1;
                }
                lower[i][i] = @sqrt@(sum);
            } else {
                lower[i][j] = sum / lower[j][j];
            }
        }
    }
    for (j = 0; j < 6; j++) {
        tt_real column[6];
        for (i = 0; i < 6; i++) {
            tt_real sum = i == j ? (tt_real)1 : zero;
            for (k = 0; k < i; k++) {
                sum -= lower[i][k] * column[k];
            }
            column[i] = sum / lower[i][i];
        }
        for (i = 5; i >= 0; i--) {
            tt_real sum = column[i];
            for (k = i + 1; k < 6; k++) {
                sum -= lower[k][i] * column[k];
            }
            column[i] = sum / lower[i][i];
        }
        for (i = 0; i < 6; i++) {
            out.inverse[i][j] = column[i];
        }
    }
@even@
    out.constant[0] = p->X_0; out.constant[1] = p->Y_0; out.constant[2] = p->Z_0;
    out.constant[3] = p->K_0; out.constant[4] = p->M_0; out.constant[5] = p->N_0;
    out.moment[0] = p->BG_x; out.moment[1] = p->BG_y; out.moment[2] = p->BG_z;
    out.weight = p->W_minus_B;
    out.inflow_loss = p->inflow_loss;
    *model = out;
    return 0;
}

/* C(nu) nu + D(nu) nu + g(eta) - tau_0, what a wrench has to overcome at constant velocity. */
static inline void tt_net_wrench(const tt_model *model, const tt_real q[4], const tt_real nu[6], tt_real out[6])
{
    const tt_real two = (tt_real)2;
    const tt_real k[3] = { two * (q[1] * q[3] - q[0] * q[2]), two * (q[2] * q[3] + q[0] * q[1]),
                           (tt_real)1 - two * (q[1] * q[1] + q[2] * q[2]) };
    const tt_real *b = model->moment;
    tt_real h[6];
    int i, j;
    for (i = 0; i < 6; i++) {
        tt_real momentum = (tt_real)0, drag = model->asymmetry[i] * nu[i] * nu[i] + model->constant[i];
        for (j = 0; j < 6; j++) {
            momentum += model->M[i][j] * nu[j];
            drag += (model->linear[i][j] + model->quadratic[i][j] * tt_absolute(nu[j])
                     + model->forward[i][j] * nu[0]) * nu[j];
        }
        h[i] = momentum;
        out[i] = -drag;
    }
    /* Kirchhoff: C(nu) nu = [omega x h1 ; v x h1 + omega x h2], and g = -[(W - B) k ; b x k] */
    out[0] += nu[4] * h[2] - nu[5] * h[1] - model->weight * k[0];
    out[1] += nu[5] * h[0] - nu[3] * h[2] - model->weight * k[1];
    out[2] += nu[3] * h[1] - nu[4] * h[0] - model->weight * k[2];
    out[3] += nu[1] * h[2] - nu[2] * h[1] + nu[4] * h[5] - nu[5] * h[4] - (b[1] * k[2] - b[2] * k[1]);
    out[4] += nu[2] * h[0] - nu[0] * h[2] + nu[5] * h[3] - nu[3] * h[5] - (b[2] * k[0] - b[0] * k[2]);
    out[5] += nu[0] * h[1] - nu[1] * h[0] + nu[3] * h[4] - nu[4] * h[3] - (b[0] * k[1] - b[1] * k[0]);
}

/* Acceleration nu_dot [m/s^2, rad/s^2] of a wrench. */
static inline void tt_forward_dynamics(const tt_model *model, const tt_real q[4], const tt_real nu[6],
                                       const tt_real tau[6], tt_real nu_dot[6])
{
    tt_real f[6];
    int i, j;
    tt_net_wrench(model, q, nu, f);
    for (i = 0; i < 6; i++) {
        f[i] = tau[i] - f[i];
    }
    for (i = 0; i < 6; i++) {
        tt_real sum = (tt_real)0;
        for (j = 0; j < 6; j++) {
            sum += model->inverse[i][j] * f[j];
        }
        nu_dot[i] = sum;
    }
}

/* Wrench [N, N m] of an acceleration. */
static inline void tt_inverse_dynamics(const tt_model *model, const tt_real q[4], const tt_real nu[6],
                                       const tt_real nu_dot[6], tt_real tau[6])
{
    int i, j;
    tt_net_wrench(model, q, nu, tau);
    for (i = 0; i < 6; i++) {
        for (j = 0; j < 6; j++) {
            tau[i] += model->M[i][j] * nu_dot[j];
        }
    }
}

/* Quaternion of the Euler angles phi, theta, psi (zyx) [rad]. */
static inline void tt_quaternion(const tt_real euler[3], tt_real q[4])
{
    const tt_real half = (tt_real)0.5;
    const tt_real cr = @cos@(half * euler[0]), sr = @sin@(half * euler[0]);
    const tt_real cp = @cos@(half * euler[1]), sp = @sin@(half * euler[1]);
    const tt_real cy = @cos@(half * euler[2]), sy = @sin@(half * euler[2]);
    q[0] = cr * cp * cy + sr * sp * sy;
    q[1] = sr * cp * cy - cr * sp * sy;
    q[2] = cr * sp * cy + sr * cp * sy;
    q[3] = cr * cp * sy - sr * sp * cy;
}

/* Euler angles phi, theta, psi (zyx) [rad] of a quaternion. */
static inline void tt_euler(const tt_real q[4], tt_real euler[3])
{
    const tt_real one = (tt_real)1, two = (tt_real)2;
    tt_real s = two * (q[0] * q[2] - q[1] * q[3]);
    s = s > one ? one : s < -one ? -one : s;
    euler[0] = @atan2@(two * (q[2] * q[3] + q[0] * q[1]), one - two * (q[1] * q[1] + q[2] * q[2]));
    euler[1] = @asin@(s);
    euler[2] = @atan2@(two * (q[1] * q[2] + q[0] * q[3]), one - two * (q[2] * q[2] + q[3] * q[3]));
}

/* R^T current, the water's velocity (NED) in the body. */
static inline void tt_into_body(const tt_real q[4], const tt_real current[3], tt_real out[3])
{
    const tt_real one = (tt_real)1, two = (tt_real)2;
    const tt_real w = q[0], x = q[1], y = q[2], z = q[3];
    out[0] = (one - two * (y * y + z * z)) * current[0] + two * (x * y + w * z) * current[1] + two * (x * z - w * y) * current[2];
    out[1] = two * (x * y - w * z) * current[0] + (one - two * (x * x + z * z)) * current[1] + two * (y * z + w * x) * current[2];
    out[2] = two * (x * z + w * y) * current[0] + two * (y * z - w * x) * current[1] + (one - two * (x * x + y * y)) * current[2];
}

/* Wrench of each thruster's unit force (6 x thrusters). */
static inline const tt_real (*tt_configuration(void))[TT_COLUMNS]
{
    static const tt_real B[6][TT_COLUMNS] = {
@configuration@
    };
    return B;
}

/* Wrench of thrusters' forces [N] on a vehicle that moves with nu: loss of thrust with inflow included. */
static inline void tt_wrench_of_forces(const tt_model *model, const tt_real nu[6], const tt_real *forces, tt_real tau[6])
{
    const tt_real (*B)[TT_COLUMNS] = tt_configuration();
    int i, k;
    for (i = 0; i < 6; i++) {
        tau[i] = (tt_real)0;
    }
    for (k = 0; k < TT_THRUSTERS; k++) {
        tt_real inflow = (tt_real)0, force = forces[k];
        for (i = 0; i < 6; i++) {
            inflow += B[i][k] * nu[i];
        }
        force -= model->inflow_loss * tt_absolute(force) * inflow;
        for (i = 0; i < 6; i++) {
            tau[i] += B[i][k] * force;
        }
    }
}

/* Rate of the 13 states [x y z, qw qx qy qz, u v w p q r], nu relative to the water, which flows with current (NED). */
static inline void tt_rate(const tt_model *model, const tt_real x[TT_STATES], const tt_real tau[6],
                           const tt_real current[3], tt_real rate[TT_STATES])
{
    const tt_real one = (tt_real)1, two = (tt_real)2, half = (tt_real)0.5;
    const tt_real qw = x[3], qx = x[4], qy = x[5], qz = x[6];
    const tt_real u = x[7], v = x[8], w = x[9], p = x[10], q = x[11], r = x[12];
    rate[0] = (one - two * (qy * qy + qz * qz)) * u + two * (qx * qy - qw * qz) * v + two * (qx * qz + qw * qy) * w + current[0];
    rate[1] = two * (qx * qy + qw * qz) * u + (one - two * (qx * qx + qz * qz)) * v + two * (qy * qz - qw * qx) * w + current[1];
    rate[2] = two * (qx * qz - qw * qy) * u + two * (qy * qz + qw * qx) * v + (one - two * (qx * qx + qy * qy)) * w + current[2];
    rate[3] = -half * (qx * p + qy * q + qz * r);
    rate[4] = half * (qw * p + qy * r - qz * q);
    rate[5] = half * (qw * q + qz * p - qx * r);
    rate[6] = half * (qw * r + qx * q - qy * p);
    tt_forward_dynamics(model, x + 3, x + 7, tau, rate + 7);
}

/* One step of Runge-Kutta of fourth order; forces (3 x thrusters, NULL: none) and the wrench at the start, the middle
 * and the end of it. 0 where all went well; 1 where the motion is not finite: x then stays as it was. */
static inline int tt_step_of_stages(const tt_model *model, tt_real x[TT_STATES], const tt_real tau[6],
                                    const tt_real *forces, const tt_real current[3], tt_real dt)
{
    tt_real rate[TT_STATES], trial[TT_STATES], total[TT_STATES], wrench[6], norm;
    int stage, i;
    for (i = 0; i < TT_STATES; i++) {
        trial[i] = total[i] = x[i];
    }
    for (stage = 0; stage < 4; stage++) {
        const tt_real weight = dt / (tt_real)(stage == 0 || stage == 3 ? 6 : 3);
        const tt_real ahead = stage == 2 ? dt : (tt_real)0.5 * dt;
        for (i = 0; i < 6; i++) {
            wrench[i] = tau[i];
        }
        if (forces != 0) {
            tt_real pushed[6];
            tt_wrench_of_forces(model, trial + 7, forces + ((stage + 1) / 2) * TT_THRUSTERS, pushed);
            for (i = 0; i < 6; i++) {
                wrench[i] += pushed[i];
            }
        }
        tt_rate(model, trial, wrench, current, rate);
        for (i = 0; i < TT_STATES; i++) {
            total[i] += weight * rate[i];
            trial[i] = x[i] + ahead * rate[i];
        }
    }
    norm = @sqrt@(total[3] * total[3] + total[4] * total[4] + total[5] * total[5] + total[6] * total[6]);
    for (i = 3; i < 7; i++) {
        total[i] /= norm;
    }
    for (i = 0; i < TT_STATES; i++) {
        if (!(tt_absolute(total[i]) <= (tt_real)@largest@)) {
            return 1;
        }
    }
    for (i = 0; i < TT_STATES; i++) {
        x[i] = total[i];
    }
    return 0;
}

/* One step with a wrench held over it. Returns as tt_step_of_stages. */
static inline int tt_step(const tt_model *model, tt_real x[TT_STATES], const tt_real tau[6], const tt_real current[3],
                          tt_real dt)
{
    return tt_step_of_stages(model, x, tau, 0, current, dt);
}
/* BEGIN THRUSTERS */
/* Curve of a thruster: command -> force. Kinds: 0 polynomial odd about the neutral command, 1 polynomial as it stands,
 * 2 table, 3 quadratic. */
typedef struct {
    int kind, limited, n, m;        /* n numbers in a, m in b */
    const tt_real *a, *b;           /* coefficients ahead and astern; commands and forces of a table; two factors */
    tt_real rest, dead_band, low, high, scale, gain, lag;
    tt_real sign_a, sign_b;         /* of the force on each branch of a polynomial: what has the other sign is none */
    tt_real nominal, exponent, reverse_exponent;  /* of the supply voltage; nominal 0: it plays no part */
    tt_real least, most;            /* [N] at nominal voltage, gain not counted; bounded only where limited is not 0 */
    int side[2], scan[2];           /* for forces below and above 0: the side of neutral that makes them (0: none), and
                                     * whether it falls in between */
    tt_real end[2];                 /* how far from neutral that side goes; 0: for ever */
    tt_real full[2];                /* how far from neutral the largest force is */
} tt_curve;

static inline const tt_curve *tt_curves(void)
{
@curves@
    return curves;
}

static inline tt_real tt_polynomial(const tt_real *c, int n, tt_real x)
{
    tt_real sum = c[n - 1];
    int i;
    for (i = n - 2; i >= 0; i--) {
        sum = c[i] + sum * x;
    }
    return sum;
}

/* Force [N] at nominal voltage without limits, dead band and gain. */
static inline tt_real tt_static_force(const tt_curve *curve, tt_real command)
{
    const tt_real zero = (tt_real)0;
    tt_real x = command - curve->rest;
    int i;
    if (curve->kind == 3) {
        return (x >= zero ? curve->a[0] : curve->a[1]) * x * tt_absolute(x);
    }
    if (curve->kind == 2) {
        if (!(command > curve->a[0])) {
            return command <= curve->a[0] ? curve->b[0] : command;
        }
        for (i = 1; i < curve->n; i++) {
            if (command <= curve->a[i]) {
                return curve->b[i - 1] + (curve->b[i] - curve->b[i - 1]) / (curve->a[i] - curve->a[i - 1])
                       * (command - curve->a[i - 1]);
            }
        }
        return curve->b[curve->n - 1];
    }
    x /= curve->scale;
    if (curve->kind == 1) {
        return tt_polynomial(curve->a, curve->n, x);
    }
    if (x > zero) {
        const tt_real f = tt_polynomial(curve->a, curve->n, x);
        return f * curve->sign_a > zero ? f : zero;
    }
    if (x < zero) {
        const tt_real f = tt_polynomial(curve->b, curve->m, -x);
        return f * curve->sign_b > zero ? -f : zero;
    }
    return x; /* 0, or NaN */
}

static inline tt_real tt_voltage_factor(const tt_curve *curve, tt_real force, tt_real voltage)
{
    if (!(curve->nominal > (tt_real)0) || !(voltage > (tt_real)0)) {
        return (tt_real)1;
    }
    return @pow@(voltage / curve->nominal, force < (tt_real)0 ? curve->reverse_exponent : curve->exponent);
}

/* Steady forces [N] of commands; voltage [V] of the supply, 0 for that of the curves. */
static inline void tt_thruster_forces(const tt_real commands[TT_THRUSTERS], tt_real voltage, tt_real forces[TT_THRUSTERS])
{
    const tt_curve *curves = tt_curves();
    int k;
    for (k = 0; k < TT_THRUSTERS; k++) {
        const tt_curve *curve = curves + k;
        tt_real c = commands[k], f;
        if (curve->limited) {
            c = c < curve->low ? curve->low : c > curve->high ? curve->high : c;
        }
        f = tt_static_force(curve, c);
        if (curve->dead_band > (tt_real)0 && tt_absolute(c - curve->rest) < curve->dead_band) {
            f = (tt_real)0;
        }
        forces[k] = curve->gain * f * tt_voltage_factor(curve, f, voltage);
    }
}

/* Wrench of commands at steady state and at rest. */
static inline void tt_thruster_wrench(const tt_real commands[TT_THRUSTERS], tt_real voltage, tt_real tau[6])
{
    const tt_real (*B)[TT_COLUMNS] = tt_configuration();
    tt_real forces[TT_THRUSTERS];
    int i, k;
    tt_thruster_forces(commands, voltage, forces);
    for (i = 0; i < 6; i++) {
        tau[i] = (tt_real)0;
        for (k = 0; k < TT_THRUSTERS; k++) {
            tau[i] += B[i][k] * forces[k];
        }
    }
}

/* The smallest distance from neutral on a side that makes at least `demand` newtons. */
static inline tt_real tt_distance(const tt_curve *curve, int which, tt_real demand)
{
    const tt_real side = (tt_real)curve->side[which], sign = (tt_real)(which == 0 ? -1 : 1);
    tt_real low = curve->dead_band, high = curve->end[which], first;
    int i;
    if (!(high > (tt_real)0)) {
        high = (tt_real)2 * low > (tt_real)1 ? (tt_real)2 * low : (tt_real)1;
        for (i = 0; i < 60 && tt_absolute(tt_static_force(curve, curve->rest + side * high)) < demand; i++) {
            high *= (tt_real)2;
        }
    }
    first = sign * tt_static_force(curve, curve->rest + side * low);
    if (first >= demand) { /* within the step at the dead band */
        return demand > (tt_real)0.5 * first ? low : (tt_real)0;
    }
    if (curve->scan[which]) { /* the first stretch that reaches it */
        const tt_real start = low, step = (high - low) / (tt_real)1024;
        tt_real before = start;
        for (i = 1; i <= 1024; i++) {
            const tt_real next = i == 1024 ? high : start + step * (tt_real)i;
            if (sign * tt_static_force(curve, curve->rest + side * next) >= demand) {
                low = before;
                high = next;
                break;
            }
            before = next;
        }
        if (i > 1024) {
            return curve->full[which];
        }
    } else if (sign * tt_static_force(curve, curve->rest + side * high) < demand) {
        return curve->full[which] > (tt_real)0 ? curve->full[which] : high;
    }
    for (i = 0; i < @bisections@; i++) {
        const tt_real middle = (tt_real)0.5 * (low + high);
        if (sign * tt_static_force(curve, curve->rest + side * middle) >= demand) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return high;
}

/* Commands that make a wrench with the least forces; where a thruster cannot do its part, all are scaled down together,
 * so that the wrench keeps its direction. */
static inline void tt_allocate(const tt_real tau[6], tt_real voltage, tt_real commands[TT_THRUSTERS])
{
    static const tt_real inverse[TT_THRUSTERS][6] = {
@allocation@
    };
    const tt_curve *curves = tt_curves();
    const tt_real zero = (tt_real)0;
    tt_real forces[TT_THRUSTERS], share = (tt_real)1, largest = zero;
    int i, k;
    for (k = 0; k < TT_THRUSTERS; k++) {
        forces[k] = zero;
        for (i = 0; i < 6; i++) {
            forces[k] += inverse[k][i] * tau[i];
        }
        largest = tt_absolute(forces[k]) > largest ? tt_absolute(forces[k]) : largest;
    }
    for (k = 0; k < TT_THRUSTERS; k++) {
        const tt_curve *curve = curves + k;
        tt_real f, end;
        if (tt_absolute(forces[k]) < (tt_real)@nothing@ * largest) {
            forces[k] = zero;
        }
        f = forces[k] / curve->gain;
        end = (f > zero ? curve->most : curve->least) * tt_voltage_factor(curve, f, voltage);
        if (curve->end[f > zero] > zero || curve->side[f > zero] == 0) {
            if ((f > zero && f > end && end / f < share) || (f < zero && f < end && end / f < share)) {
                share = end / f;
            }
        }
    }
    for (k = 0; k < TT_THRUSTERS; k++) {
        const tt_curve *curve = curves + k;
        const tt_real f = forces[k] * share / curve->gain;
        const int which = f > zero;
        commands[k] = curve->rest;
        if (f != zero && curve->side[which] != 0) {
            commands[k] += (tt_real)curve->side[which]
                           * tt_distance(curve, which, tt_absolute(f) / tt_voltage_factor(curve, f, voltage));
        }
    }
}

/* One step with commands held over it. `forces` [N] are those in force, with the first-order lag of the thrusters, and
 * are carried from step to step (all 0 to begin with); tau is a wrench beside them. Returns as tt_step_of_stages. The
 * step is cut into pieces of at most a quarter of the shortest lag. */
static inline int tt_step_commands(const tt_model *model, tt_real x[TT_STATES], tt_real forces[TT_THRUSTERS],
                                   const tt_real commands[TT_THRUSTERS], tt_real voltage, const tt_real tau[6],
                                   const tt_real current[3], tt_real dt)
{
    const tt_curve *curves = tt_curves();
    tt_real target[TT_THRUSTERS], now[TT_THRUSTERS], stages[3 * TT_THRUSTERS], moved[TT_STATES], longest = dt, length, parts;
    int i, k, pieces;
    tt_thruster_forces(commands, voltage, target);
    for (k = 0; k < TT_THRUSTERS; k++) {
        now[k] = forces[k];
        if (curves[k].lag > (tt_real)0 && (tt_real)0.25 * curves[k].lag < longest) {
            longest = (tt_real)0.25 * curves[k].lag;
        }
    }
    parts = dt / longest * ((tt_real)1 - (tt_real)1e-9);
    pieces = parts > (tt_real)63 ? 64 : (tt_real)(int)parts < parts ? (int)parts + 1 : (int)parts;
    pieces = pieces < 1 ? 1 : pieces;
    length = dt / (tt_real)pieces;
    for (i = 0; i < TT_STATES; i++) {
        moved[i] = x[i];
    }
    for (i = 0; i < pieces; i++) {
        for (k = 0; k < TT_THRUSTERS; k++) {
            const tt_real lag = curves[k].lag, away = now[k] - target[k];
            const tt_real half = lag > (tt_real)0 ? @exp@((tt_real)-0.5 * length / lag) : (tt_real)0;
            stages[k] = lag > (tt_real)0 ? now[k] : target[k];
            stages[TT_THRUSTERS + k] = target[k] + away * half;
            now[k] = target[k] + away * half * half;
            stages[2 * TT_THRUSTERS + k] = now[k];
        }
        if (tt_step_of_stages(model, moved, tau, stages, current, length) != 0) {
            return 1;
        }
    }
    for (i = 0; i < TT_STATES; i++) {
        x[i] = moved[i];
    }
    for (k = 0; k < TT_THRUSTERS; k++) {
        forces[k] = now[k];
    }
    return 0;
}
/* END THRUSTERS */
static inline int tt_apart(const tt_real *found, const tt_real *expected, int n, tt_real tolerance)
{
    tt_real scale = (tt_real)1e-3;
    int i, wrong = 0;
    for (i = 0; i < n; i++) {
        scale = tt_absolute(expected[i]) > scale ? tt_absolute(expected[i]) : scale;
    }
    for (i = 0; i < n; i++) {
        wrong += !(tt_absolute(found[i] - expected[i]) <= tolerance * scale);
    }
    return wrong;
}

/* Number of values that differ from those stored with the model; 0 where compiler and processor do as they should. */
static inline int tt_self_test(void)
{
    static const tt_real cases[@cases@][@case_numbers@] = {
@vectors@
    };
    const tt_real tolerance = (tt_real)@tolerance@;
    const tt_parameters parameters = tt_default_parameters();
    tt_model model;
    int i, j, wrong = 0;
    if (tt_prepare(&parameters, &model) != 0) {
        return 1;
    }
    for (i = 0; i < @cases@; i++) {
        const tt_real *at = cases[i], *q = at + 3, *nu = at + 7, *tau = at + 13, *current = at + 19, *expected = at + 22;
        tt_real found[TT_STATES];
        tt_forward_dynamics(&model, q, nu, tau, found);
        wrong += tt_apart(found, expected, 6, tolerance);
        tt_inverse_dynamics(&model, q, nu, expected, found);
        wrong += tt_apart(found, tau, 6, tolerance);
        for (j = 0; j < TT_STATES; j++) {
            found[j] = at[j];
        }
        wrong += tt_step(&model, found, tau, current, (tt_real)0.01);
        wrong += tt_apart(found, expected + 6, 7, tolerance) + tt_apart(found + 7, expected + 13, 6, tolerance);
/* BEGIN THRUSTERS */
        {
            const tt_real *commands = expected + 19, *wrench = commands + TT_THRUSTERS, *allocated = wrench + 6;
            tt_real found_commands[TT_THRUSTERS];
            tt_thruster_wrench(commands, (tt_real)0, found);
            wrong += tt_apart(found, wrench, 6, tolerance);
            tt_allocate(wrench, (tt_real)0, found_commands);
            wrong += tt_apart(found_commands, allocated, TT_THRUSTERS, (tt_real)@allocated@);
        }
/* END THRUSTERS */
    }
    return wrong;
}

#endif
