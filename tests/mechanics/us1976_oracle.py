"""The US Standard Atmosphere 1976 from 86 to 1000 km by its own equations: diffusive equilibrium of six gases.

Source: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562: equations (25) to (40), constants of tables 2, 5 and 6,
number densities at 86 km of its appendix A. Heights in km, the rest in SI.
"""

from typing import Any

import numpy as np
from scipy.integrate import cumulative_simpson

BOLTZMANN, AVOGADRO, GAS, G0, R0 = 1.380622e-23, 6.022169e26, 8314.32, 9.80665, 6356.766
#: Molar mass, number density at 86 km, a and b of the diffusion coefficient, thermal diffusion, Q, U, W, q, u, w.
GASES = {
    "O": (15.9994, 8.6e16, 6.986e20, 0.75, 0.0, -5.809644e-4, 56.90311, 2.706240e-5, -3.416248e-3, 97.0, 5.008765e-4),
    "O2": (31.9988, 3.030898e19, 4.863e20, 0.75, 0.0, 1.366212e-4, 86.0, 8.333333e-5, 0.0, 97.0, 0.0),
    "Ar": (39.948, 1.3514e18, 4.487e20, 0.87, 0.0, 9.434079e-5, 86.0, 8.333333e-5, 0.0, 97.0, 0.0),
    "He": (4.0026, 7.5817e14, 1.7e21, 0.691, -0.4, -2.457369e-4, 86.0, 6.666667e-4, 0.0, 97.0, 0.0),
}
N2, M_N2, M_AIR = 1.129794e20, 28.0134, 28.9644
H, M_H, A_H, B_H, ALPHA_H, FLUX = 8.0e10, 1.00797, 3.305e21, 0.5, -0.25, 7.2e11
MASSES = {name: row[0] for name, row in GASES.items()} | {"N2": M_N2, "H": M_H}


def temperature(z: Any) -> tuple[Any, Any]:
    """Kinetic temperature in K and dT/dZ in K/km."""
    a, A = -19.9429, -76.3232
    inside = np.clip((z - 91.0) / a, -1.0 + 1e-12, 0.0)
    arc = np.sqrt(1.0 - inside**2)
    xi = (z - 120.0) * (R0 + 120.0) / (R0 + z)
    above = 640.0 * np.exp(-0.01875 * xi)
    slope = 0.01875 * ((R0 + 120.0) / (R0 + z)) ** 2 * above
    conditions = [z < 91.0, z < 110.0, z < 120.0]
    T = np.select(conditions, [186.8673 + 0.0 * z, 263.1905 + A * arc, 240.0 + 12.0 * (z - 110.0)], 1000.0 - above)
    return T, np.select(conditions, [0.0 * z, -A / a * inside / arc, 12.0 + 0.0 * z], slope)


def gases(z: Any) -> tuple[Any, dict[str, Any]]:
    """Kinetic temperature and number densities on an even grid from 86 km, fine enough to integrate on."""
    T, slope = temperature(z)
    g = G0 * (R0 / (R0 + z)) ** 2
    step = 1e3 * (z[1] - z[0])

    def integral(f: Any) -> Any:
        return cumulative_simpson(f, dx=step, initial=0.0)

    falling = 120.0 * np.exp(1.0 - 400.0 / np.maximum(400.0 - (z - 95.0) ** 2, 1e-9))
    eddy = np.select([z < 95.0, z < 115.0], [120.0 + 0.0 * z, falling], 0.0)
    mixed = np.where(z <= 100.0, M_AIR, M_N2)
    n = {"N2": N2 * T[0] / T * np.exp(-integral(mixed * g / (GAS * T)))}
    for name, (M, start, a, b, alpha, Q, U, W, q, u, w) in GASES.items():
        background = n["N2"] if name in ("O", "O2") else n["N2"] + n["O"] + n["O2"]
        D = a / background * (T / 273.15) ** b
        f = g / (GAS * T) * D / (D + eddy) * (M + mixed * eddy / D + alpha * GAS / g * slope * 1e-3)
        v = Q * (z - U) ** 2 * np.exp(-W * (z - U) ** 3)
        v = v + np.where(z < u, q * (u - z) ** 2 * np.exp(-w * np.maximum(u - z, 0.0) ** 3), 0.0)
        n[name] = start * T[0] / T * np.exp(-integral(f + 1e-3 * v))
    D = A_H / sum(n.values()) * (T / 273.15) ** B_H
    at = np.argmin(abs(z - 500.0))
    tau = integral(g * M_H / (GAS * T))
    tau = tau - tau[at]
    escape = FLUX / D * (T / T[at]) ** (1.0 + ALPHA_H) * np.exp(np.minimum(tau, 50.0))
    flow = integral(np.where(z >= 149.0, escape, 0.0))
    n["H"] = np.where(z >= 150.0, (H - flow + flow[at]) * (T[at] / T) ** (1.0 + ALPHA_H) * np.exp(-tau), 0.0)
    return T, n


def atmosphere(z: Any) -> tuple[Any, Any, Any]:
    """Kinetic temperature, pressure and density on such a grid."""
    T, n = gases(z)
    return T, sum(n.values()) * BOLTZMANN * T, sum(n[k] * MASSES[k] for k in n) / AVOGADRO
