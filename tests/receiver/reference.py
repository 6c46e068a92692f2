"""A plain tightly coupled receiver: dense matrices, one epoch after the other.

Written from the conventions that the golden runs of the reference software are reproduced with,
and from nothing of the package but its constants; and the textbook's update in one step.
"""

import numpy as np

MU, J2, R0, E2 = 3.986004418e14, 1.082627e-3, 6378137.0, 0.0818191908425**2
RATE, LIGHT = 7.292115e-5, 299792458.0
I3 = np.eye(3)


def skew(a):
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


OMEGA = skew([0.0, 0.0, RATE])


def gravity(r):
    n = np.linalg.norm(r)
    z2 = 5.0 * (r[2] / n) ** 2
    t = np.array([(1.0 - z2) * r[0], (1.0 - z2) * r[1], (3.0 - z2) * r[2]])
    gamma = -MU / n**3 * (r + 1.5 * J2 * (R0 / n) ** 2 * t)
    return gamma + RATE**2 * np.array([r[0], r[1], 0.0])


def surface_radius(r):
    """r_eS, with the geodetic latitude by iteration."""
    p = np.hypot(r[0], r[1])
    latitude = np.arctan2(r[2], p * (1.0 - E2))
    for _ in range(20):
        transverse = R0 / np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(r[2] + E2 * transverse * np.sin(latitude), p)
    s, c = np.sin(latitude), np.cos(latitude)
    return R0 / np.sqrt(1.0 - E2 * s**2) * np.sqrt(c**2 + (1.0 - E2) ** 2 * s**2)


def mechanize(C, v, r, f, w, dt):
    alpha = w * dt
    size = np.linalg.norm(alpha)
    A, a = skew(alpha), RATE * dt
    if size > 1e-8:
        s, c = np.sin(size) / size, (1.0 - np.cos(size)) / size**2
        turn, mean = I3 + s * A + c * A @ A, I3 + c * A + (1.0 - s) / size**2 * A @ A
    else:
        turn, mean = I3 + A, I3
    earth = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
    f_e = (C @ mean - 0.5 * skew([0.0, 0.0, a]) @ C) @ f
    new = v + dt * (f_e + gravity(r) - 2.0 * OMEGA @ v)
    return earth @ C @ turn, new, r + 0.5 * dt * (v + new)


def transition(C, r, f, tau):
    Phi = np.eye(17)
    Phi[0:3, 0:3] -= OMEGA * tau
    Phi[0:3, 12:15] = C * tau
    Phi[3:6, 0:3] = -skew(C @ f) * tau
    Phi[3:6, 3:6] -= 2.0 * OMEGA * tau
    n = np.linalg.norm(r)
    Phi[3:6, 6:9] = -2.0 * tau / (surface_radius(r) * n) * np.outer(gravity(r), r)
    Phi[3:6, 9:12] = C * tau
    Phi[6:9, 3:6] = I3 * tau
    Phi[15, 16] = tau
    return Phi


def range_and_rate(s, sv, r, v):
    a = RATE * np.linalg.norm(s - r) / LIGHT
    sagnac = np.array([[1.0, a, 0.0], [-a, 1.0, 0.0], [0.0, 0.0, 1.0]])
    d = sagnac @ s - r
    rho = np.linalg.norm(d)
    u = d / rho
    return rho, u @ (sagnac @ (sv + OMEGA @ s) - (v + OMEGA @ r)), u


def replay(recording, ends, P, psd, R, start, min_satellites=4):
    """Run the receiver over a recording: its state after each update.

    `ends` are the numbers of samples up to each epoch.
    """
    C, v, r = np.array(start.C_eb), np.array(start.velocity_e), np.array(start.position_e)
    clock = np.array([start.clock_bias_m, start.clock_drift_mps])
    biases = np.zeros(6)
    intervals = np.diff(recording.imu_time, prepend=0.0)
    last, previous = 0, 0.0
    for k, end in enumerate(ends):
        for i in range(last, end):
            f = recording.specific_force_b[i] - biases[:3]
            w = recording.angular_rate_b[i] - biases[3:]
            C, v, r = mechanize(C, v, r, f, w, intervals[i])
        tau = recording.gnss_time[k] - previous
        last, previous = end, recording.gnss_time[k]
        Phi, Q = transition(C, r, f, tau), np.diag(psd * tau)
        P = Phi @ (P + Q / 2.0) @ Phi.T + Q / 2.0
        clock[0] += clock[1] * tau

        measured = [recording.pseudorange[k], recording.range_rate[k]]
        satellites = recording.satellite_position_e[k], recording.satellite_velocity_e[k]
        use = np.isfinite(measured).all(axis=0)
        use &= np.isfinite(satellites).all(axis=(0, 2))
        n = len(use)
        H, z = np.zeros((2 * n, 17)), np.zeros(2 * n)
        for s in np.flatnonzero(use):
            rho, rate, u = range_and_rate(satellites[0][s], satellites[1][s], r, v)
            z[s], z[n + s] = measured[0][s] - rho - clock[0], measured[1][s] - rate - clock[1]
            H[s, 6:9], H[s, 15] = u, 1.0
            H[n + s, 3:6], H[n + s, 16] = u, 1.0
        coasting = use.sum() < min_satellites
        if not coasting:
            both = np.concatenate([use, use])
            H = H[both]
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R[both]))
            x = K @ z[both]
            P = (np.eye(17) - K @ H) @ P
            C = (I3 - skew(x[:3])) @ C
            v, r = v - x[3:6], r - x[6:9]
            biases = biases + x[9:15]
            clock = clock + x[15:17]
        known = {"position_e": r, "velocity_e": v, "C_eb": C, "clock": clock.copy()}
        known |= {"accel_bias_b": biases[:3], "gyro_bias_b": biases[3:], "innovation": z}
        yield {**known, "sd": np.sqrt(np.diag(P)), "coasting": bool(coasting)}


# --- made-up beliefs, and the update of one epoch ------------------------------------------------

SD = np.array([*np.repeat([2e-4, 0.05, 8.0, 3e-4, 5e-9], 3), 6.0, 0.3])
"""Standard deviations of the 17 states that a filter has in flight."""


def measured(rng, n):
    R = np.concatenate([rng.uniform(0.5, 30.0, n), rng.uniform(1e-3, 0.1, n)])
    return rng.standard_normal(2 * n) * 3.0 * np.sqrt(R), R


def covariance(rng):
    root = rng.standard_normal((17, 17))
    correlation = root @ root.T / 17.0 + 0.05 * np.eye(17)
    return correlation * np.outer(SD, SD)


def sky(rng, n):
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1)[:, None]


def design(u, visible):
    n = len(u)
    H = np.zeros((2 * n, 17))
    H[:n, 6:9], H[:n, 15] = u, 1.0
    H[n:, 3:6], H[n:, 16] = u, 1.0
    return H * np.concatenate([visible, visible])[:, None]


def textbook(P, u, z, R, w, visible, update):
    """State correction and updated covariance, with the weights W on the gain's columns."""
    both = np.concatenate([visible, visible])
    H = design(u, visible)[both]
    z, R, w = z[both], np.diag(R[both]), w[both]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    KW = K * w
    if update == "unweighted":
        after = (np.eye(17) - K @ H) @ P
    elif update == "plain":
        after = (np.eye(17) - KW @ H) @ P
        after = 0.5 * (after + after.T)
    else:
        left = np.eye(17) - KW @ H
        after = left @ P @ left.T + KW @ R @ KW.T
    return KW @ z, after
