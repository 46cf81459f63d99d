"""Table columns of NASA's published trajectories for a flight, for comparison.

Source of names and units: the files that come with NASA/TM-2015-218675, Check-Cases for Verification of
6-Degree-of-Freedom Flight Vehicle Simulations (2015).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ... import units as u
from ...checks import instance, listed
from ...errors import InputError, ModelError, ShapeError
from ...groups.columns import Column, Layout

__all__ = ["UNITS", "NasaColumns"]

#: Units as the files spell them.
UNITS = {
    "m": u.metres,
    "ft": u.feet,
    "m_s": u.metres / u.seconds,
    "ft_s": u.feet / u.seconds,
    "ft_min": u.feet / u.minutes,
    "nmi_h": u.knots,
    "m_s2": u.metres / u.seconds**2,
    "ft_s2": u.feet / u.seconds**2,
    "rad": u.radians,
    "deg": u.degrees,
    "rad_s": u.radians / u.seconds,
    "deg_s": u.degrees / u.seconds,
    "kg_m3": u.kilograms / u.metres**3,
    "slug_ft3": u.slugs / u.feet**3,
    "Pa": u.pascals,
    "lbf_ft2": u.pounds_force / u.feet**2,
    "K": u.kelvins,
    "dgR": u.rankines,
    "N": u.newtons,
    "lbf": u.pounds_force,
    "Nm": u.newtons * u.metres,
    "ftlbf": u.feet * u.pounds_force,
}

_XYZ, _TURNS = ("X", "Y", "Z"), ("Roll", "Pitch", "Yaw")
#: The column name of a quantity, the corresponding output, its units in the files in English units and in SI, and its
#: components.
_QUANTITIES: tuple[tuple[str, str, str, str, tuple[str, ...]], ...] = (
    ("eiPosition", "position", "ft", "m", _XYZ),
    ("eiVelocity", "velocity", "ft_s", "m_s", _XYZ),
    ("gePosition", "fixed_position", "ft", "m", _XYZ),
    ("feVelocity", "ned_velocity", "ft_s", "m_s", _XYZ),
    ("altitudeMsl", "altitude", "ft", "m", ()),
    ("longitude", "longitude", "deg", "rad", ()),
    ("latitude", "latitude", "deg", "rad", ()),
    ("localGravity", "local_gravity", "ft_s2", "m_s2", ()),
    ("eulerAngle", "euler", "deg", "rad", _TURNS),
    ("bodyAngularRateWrtEi", "rate", "deg_s", "rad_s", _TURNS),
    ("altitudeRateWrtMsl", "altitude_rate", "ft_min", "m_s", ()),
    ("speedOfSound", "speed_of_sound", "ft_s", "m_s", ()),
    ("airDensity", "density", "slug_ft3", "kg_m3", ()),
    ("ambientPressure", "pressure", "lbf_ft2", "Pa", ()),
    ("ambientTemperature", "temperature", "dgR", "K", ()),
    ("aero_bodyForce", "aero_force", "lbf", "N", _XYZ),
    ("aero_bodyMoment", "aero_moment", "ftlbf", "Nm", ("L", "M", "N")),
    ("mach", "mach", "", "", ()),
    ("dynamicPressure", "dynamic_pressure", "lbf_ft2", "Pa", ()),
    ("trueAirspeed", "airspeed", "nmi_h", "m_s", ()),
)


@dataclasses.dataclass(frozen=True)
class NasaColumns(Layout):
    """Table columns with the names and units of NASA's check-cases: `solution.to_csv(path, flight.NasaColumns())`.

    They cover `Vehicle.outputs()` and the altitude rate $h' = -v_d$. Other outputs of the system are included if they
    have one of these names: local_gravity, speed_of_sound, pressure, temperature, mach and dynamic_pressure (),
    aero_force and aero_moment (3,). Columns without an output are omitted.

    Attributes:
        si: True for m, s, rad, kg, N, Pa and K, as in the files with _si in their names; False for feet, degrees,
            slugs, pounds and knots.
    Raises: ModelError for an `si` that is not a bool.
    """

    si: bool = False

    def __post_init__(self) -> None:
        instance("NasaColumns: si", self.si, bool, "True or False", ModelError)

    def columns(self, solution: Any) -> list[Column]:
        """Raises InputError if no output has one of these names, and ShapeError for an output of another shape."""
        outputs = {name: np.asarray(value) for name, value in solution.outputs.items()}
        if "ned_velocity" in outputs:
            outputs = {"altitude_rate": -outputs["ned_velocity"][:, 2]} | outputs
        columns = [Column("time", "", np.asarray(solution.ts))]
        for quantity, name, english, si, components in _QUANTITIES:
            if name in outputs:
                unit = si if self.si else english
                values, shape = outputs[name], (len(components),) if components else ()
                if values.shape[1:] != shape:
                    raise ShapeError(
                        f"NasaColumns expects the output {name!r} with shape {shape}, got {values.shape[1:]}"
                    )
                values = values / float(UNITS[unit]) if unit else values
                parts = zip(components or ("",), values.reshape(len(values), -1).T, strict=True)
                columns += [Column("_".join(filter(None, (quantity, unit, part))), "", v) for part, v in parts]
        if len(columns) == 1:
            raise InputError(
                f"NasaColumns expects outputs of a flight, such as 'position', got {listed(outputs)}.\n"
                "  fix: integrate vehicle.system(...), or use the output names that NasaColumns lists"
            )
        return columns
