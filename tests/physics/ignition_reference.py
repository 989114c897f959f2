"""Reference of `the_implicit_methods_pass_an_ignition` in `integrators.rs`.

Run: python ignition_reference.py

Solves the adiabatic reactor dc/dt = -r, dT/dt = 1.5 r with r = c exp(15 - 15 / T) from c = T = 1,
by SciPy's Radau method. Prints c and T at the times below, before and after the ignition.
"""

import numpy as np
from scipy.integrate import solve_ivp

TIMES = [0.02, 0.04, 0.1]


def rate(_t, x):
    reaction = x[0] * np.exp(15.0 - 15.0 / x[1])
    return [-reaction, 1.5 * reaction]


def jacobian(_t, x):
    factor = np.exp(15.0 - 15.0 / x[1])
    slopes = [factor, 15.0 * factor * x[0] / x[1] ** 2]
    return [[-slopes[0], -slopes[1]], [1.5 * slopes[0], 1.5 * slopes[1]]]


found = solve_ivp(rate, (0.0, TIMES[-1]), [1.0, 1.0], "Radau", TIMES, rtol=1e-12, atol=1e-14, jac=jacobian)
for t, x in zip(found.t, found.y.T):
    print(f"{t}: {x[0]:.12f}, {x[1]:.12f}")
