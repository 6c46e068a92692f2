"""What the paper prints, and what a second program of the same paper found."""

from __future__ import annotations

TABLES = {
    "jump": {
        "GNSS": (10.17, 9.88, 13.47, 21.11, 20.83, 29.42),
        "EKF": (9.92, 9.80, 13.24, 21.08, 20.83, 28.89),
        "RIO": (1.21, 1.86, 1.39, 2.48, 5.79, 5.80),
        "ACNA": (1.06, 1.63, 1.14, 2.01, 4.94, 5.02),
    },
    "slow": {
        "GNSS": (24.69, 24.55, 34.27, 76.39, 75.97, 107.73),
        "EKF": (23.56, 23.52, 32.76, 73.33, 73.52, 103.84),
        "RIO": (5.14, 5.44, 6.77, 11.76, 13.75, 17.06),
        "ACNA": (1.07, 1.66, 1.17, 2.01, 5.05, 5.12),
    },
    "both": {
        "GNSS": (8.67, 8.78, 11.80, 25.34, 24.70, 35.39),
        "EKF": (7.80, 8.04, 10.65, 22.89, 22.41, 32.03),
        "RIO": (5.11, 5.40, 6.75, 12.01, 13.93, 17.37),
        "ACNA": (0.78, 0.97, 0.81, 2.01, 3.38, 3.38),
    },
}
"""Tables 3 to 5 by data set, in the order of `measures.QUANTITIES` [m]."""

SECOND = {
    "jump": {
        "GNSS": ((9.96, 0.45), (10.05, 0.41), (13.52, 0.37), (30.1, 0.8)),
        "EKF": ((9.76, 0.45), (9.85, 0.42), (13.30, 0.37), (29.4, 0.8)),
        "RIO": ((0.71, 0.27), (1.23, 0.30), (0.95, 0.28), (3.89, 0.84)),
        "ACNA": ((0.71, 0.27), (1.23, 0.30), (0.95, 0.28), (3.89, 0.84)),
    },
    "slow": {
        "GNSS": ((24.3, 1.1), (24.4, 1.1), (33.96, 1.02), (106.3, 2.9)),
        "EKF": ((23.3, 1.1), (23.4, 1.1), (32.54, 1.00), (102.6, 2.9)),
        "RIO": ((4.55, 0.57), (5.59, 0.63), (6.68, 0.68), (15.7, 1.4)),
        "ACNA": ((0.66, 0.26), (1.37, 0.33), (1.03, 0.30), (4.11, 0.88)),
    },
    "both": {
        "GNSS": ((8.60, 0.28), (8.57, 0.30), (11.55, 0.37), (35.4, 1.8)),
        "EKF": ((7.76, 0.28), (7.74, 0.30), (10.49, 0.33), (31.8, 1.6)),
        "RIO": ((4.60, 0.57), (5.52, 0.69), (6.69, 0.69), (15.8, 1.4)),
        "ACNA": ((0.67, 0.20), (1.64, 0.42), (1.45, 0.48), (5.5, 1.6)),
        "ACNA, production": ((0.74, 0.27), (0.82, 0.25), (0.58, 0.17), (2.6, 0.5)),
    },
}
"""Mean and standard deviation of one run: sigma east, sigma north, sigma, max [m]."""

TABLE_6 = {
    "GNSS": (0.59, 20.01, None),
    "EKF": (0.53, 20.16, -0.74),
    "RIO": (0.53, 12.77, 36.19),
    "ACNA": (0.54, 1.49, 92.53),
}
"""Clean sigma [m], gamma, zeta [%]; the attacked sigma is that of table 5."""
SECOND_CLEAN = {"GNSS": (0.60, 0.13), "EKF": (0.54, 0.14), "RIO": (0.54, 0.14)}
SECOND_GAMMA = {"GNSS": 19.8, "EKF": 19.7, "RIO": 12.6, "ACNA": 2.8, "ACNA, production": 1.06}

TABLE_7 = {"EKF": (None, None), "RIO": (1.0, 27.0), "ACNA": (2.0, 5.0)}
"""Latency of jump and slow change [s]."""

SIGMA_RATIO = {
    "EKF": {"jump": (0.977, 0.992), "slow": (0.953, 0.963), "both": (0.897, 0.919)},
    "RIO": {"jump": (0.018, 0.17), "slow": (0.14, 0.25), "both": (0.44, 0.76)},
    "ACNA": {"jump": (0.018, 0.18), "slow": (0.008, 0.076), "both": (0.025, 0.27)},
    "ACNA, production": {"jump": (0.018, 0.17), "slow": (0.007, 0.069), "both": (0.025, 0.095)},
}
"""Sigma over that of GNSS: 1 and 99 % of the second program's runs, hard iron of 2 to 6 deg."""
ZETA = {
    "EKF": {"jump": (-42.0, 8.0), "slow": (-38.0, 10.0), "both": (-31.0, 15.0)},
    "RIO": {"jump": (82.0, 98.0), "slow": (69.0, 85.0), "both": (5.0, 53.0)},
    "ACNA, production": {"jump": (83.0, 98.0), "slow": (93.0, 99.0), "both": (90.5, 97.0)},
}
"""Likewise, zeta [%]."""
SLOW_LATENCY = {
    "RIO": {"slow": (20.0, 32.0), "both": (20.0, 33.0)},
    "ACNA": {"slow": (2.0, 6.0)},
    "ACNA, production": {"both": (1.0, 6.0)},
}
"""Likewise, latency of the slow change [s]."""
JUMP_LATENCY = {"RIO": 1.0, "ACNA": 1.0, "ACNA, production": 2.0}
"""Of every run [s]."""

FIG_10 = {1: 1.0, 2: 0.9967, 5: 0.9867, 10: 0.970}
"""Second program: largest P_D by n_j, alarms as they come."""
FIG_12 = {1: 0.994, 3: 0.992, 5: 0.990, 10: 0.985, 20: 0.980}
"""Second program: largest P_D by n_s."""
RAMPS = {
    0.3: (6.3, 1.0),
    0.2: (10.5, 1.0),
    0.15: (17.0, 1.0),
    0.1: (53.0, 0.98),
    0.05: (None, 0.19),
}
"""Second program: latency [s] and share of runs with an alarm, by rate of each axis [m/s]."""
