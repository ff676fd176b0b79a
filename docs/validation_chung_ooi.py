"""The benchmarks of Chung & Ooi, Granular Matter 13 (2011) 643: closed forms from the scene alone, and the figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from validation_entry import BOTH, Entry

from kncal.observe.run_data import RunData
from kncal.scene.scene import Scene

# --- closed forms, from the scene alone ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Impact:
    """A sphere on a rigid plane, or two equal ones: effective values, and the motion before."""

    m: float
    R: float
    E: float
    v_n: float
    v_t: float
    rim: float

    @property
    def s(self) -> float:
        """Slip of the contact point over the normal speed [-]."""
        return (self.v_t + self.rim) / self.v_n


def impact(scene: Scene) -> Impact:
    """Return the impact of the first particle, on a plane (normal z) or on an equal sphere (along x)."""
    ball = next(iter(scene.particles.values()))
    material = scene.materials[ball.material]
    R, E = ball.diameter / 2.0, material.young / (1.0 - material.poisson**2)
    m = material.density * 4.0 / 3.0 * math.pi * R**3
    if len(scene.particles) == 1:
        return Impact(m, R, E, -ball.velocity[2], ball.velocity[0], R * abs(ball.spin[1]))
    other = [*scene.particles.values()][1]
    closing = ball.velocity[0] - other.velocity[0]
    return Impact(m / 2.0, R / 2.0, E / 2.0, closing, 0.0, R * abs(ball.spin[1]))


def hertz_overlap(scene: Scene) -> float:
    """(15 m v²/(16 E sqrt(R)))^(2/5)."""
    i = impact(scene)
    return float((15.0 * i.m * i.v_n**2 / (16.0 * i.E * math.sqrt(i.R))) ** 0.4)


def hertz_time(scene: Scene) -> float:
    """2.943275 delta_max/v."""
    return 2.943275 * hertz_overlap(scene) / impact(scene).v_n


def lost(scene: Scene) -> float:
    """Tangential speed that sliding takes from the centre, over the normal speed: mu (1 + e_n)."""
    return scene.contact.friction * (1.0 + scene.contact.e_n)


def slides(scene: Scene) -> bool:
    """Whether it slides to its end, with 2 % to spare."""
    return impact(scene).s > 1.02 * 3.5 * lost(scene)


def recoil(run: RunData) -> float:
    """Slip of the contact point after the contact over the normal speed then [-]."""
    return run.observations.metrics["slip_out"] / run.observations.metrics["v_out"]


def slip_lost(run: RunData) -> float:
    """Slip that the contact took, over what sliding to its end takes, (7/2) mu (1 + e_n) v_n [-]."""
    scene = run.model.scene
    before = impact(scene)
    return (before.s - run.observations.metrics["slip_out"] / before.v_n) / (3.5 * lost(scene))


def restitution(scene: Scene) -> float:
    """The e_n asked for."""
    return scene.contact.e_n


# --- figures of Chung & Ooi, as read in Kratos' benchmarks: abscissa -> ordinate ------------------------------------

FIGURE_4_RESTITUTION = {5: 0.948, 10: 0.687, 15: 0.624, 20: 0.616, 25: 0.634, 30: 0.684, 35: 0.737, 40: 0.781}
FIGURE_4_SPIN = {
    5: 19,
    10: 213,
    15: 378,
    20: 511,
    25: 599,
    30: 617,
    35: 582,
    40: 545,
    50: 457,
    60: 357,
    70: 246,
    80: 126,
}
FIGURE_4_ANGLE = {
    5: 3.8,
    10: -1.6,
    15: -5.5,
    20: -7.5,
    25: -7.5,
    30: -3.5,
    35: 3.4,
    40: 11.6,
    50: 29.4,
    60: 47.8,
    80: 78.7,
}
FIGURE_5_RECOIL = {0.33: -0.28, 0.67: -0.49, 1: -0.75, 1.34: -1.0, 2: -1.53, 3: -2.44, 4: -2.79, 5: -2.0, 6: -1.01}
FIGURE_5_FEM = {2: -0.70, 3: -1.38, 4: -1.72, 5: -1.60, 6: -1.05, 13: 6.01}
FIGURE_6_RECOIL = {
    25: 0.0893,
    35: 0.0495,
    45: -0.151,
    50: -0.271,
    55: -0.351,
    60: -0.377,
    65: 0.052,
    70: 1.27,
    75: 3.24,
    80: 7.13,
}


def angle(scene: Scene) -> int:
    """Angle of the contact point's velocity from the normal, before [degrees]."""
    return round(math.degrees(math.atan(impact(scene).s)))


def normed(scene: Scene) -> float:
    """Slip over normal speed and friction, before [-]."""
    return round(impact(scene).s / scene.contact.friction, 2)


def figure(
    points: dict[int, float] | dict[float, float], at: Callable[[Scene], float]
) -> dict[str, Callable[[Scene], float]]:
    """Return the arguments of an entry that compares with the points of a figure."""
    known = {float(x): y for x, y in points.items()}
    return {"only": lambda scene: at(scene) in known, "reference": lambda scene: known[at(scene)]}  # type: ignore[dict-item]


# --- the entries ----------------------------------------------------------------------------------------------------


def _motion(run: RunData, name: str) -> np.ndarray:
    return np.asarray(getattr(run.trajectory, name))


def _spins(run: RunData) -> float:
    spin = np.linalg.norm(_motion(run, "spin"), axis=2)
    return float(spin[-1, 0] / spin[0, 0])


def _angle(run: RunData) -> float:
    return math.degrees(math.atan(recoil(run)))


LIMESTONE = ("materials.glass.young=20e9", "materials.glass.poisson=0.25", "materials.glass.density=2500")
IRON = tuple(f"materials.aluminium_oxide.{key}" for key in ("young=100e9", "poisson=0.25", "density=7000"))
SERIES = ("contact.e_n=0.2,0.4,0.6,0.8,1", "run.steps_per_contact=1000")
_CO = "Chung & Ooi (2011), benchmarks 1 to 8"
_READ, _HERTZ, _SLIDING = "figure, as read in Kratos' benchmarks", "Hertz theory", "sliding, closed form"
_F4 = {"section": _CO, "source": _READ, "case": "chung_ooi_4", "points": "points.csv"}
_STICKS = "figure, sticking: codes differ"


def _hertz(what: str, case: str, sets: tuple[str, ...] = (), points: str = "") -> list[Entry]:
    same = {"section": _CO, "source": _HERTZ, "case": case, "sets": sets, "points": points, "tolerance": 0.001}
    return [
        Entry(what=f"{what}: duration", metric="t_c", reference=hertz_time, **same),  # type: ignore[arg-type]
        Entry(what=f"{what}: largest overlap", metric="delta_max", reference=hertz_overlap, **same),  # type: ignore[arg-type]
    ]


def _sliding(what: str, case: str, points: str = "points.csv") -> Entry:
    return Entry(
        section=_CO,
        what=f"{what}: slip that is lost, over that of sliding to the end",
        source=_SLIDING,
        case=case,
        points=points,
        metric="slip_lost",
        models=BOTH,
        value=slip_lost,
        only=slides,
        reference=1.0,
        tolerance=0.03,  # the closed form leaves out that the tangential spring must be loaded first
    )


CHUNG_OOI = [
    *_hertz("1, glass", "head_on_collision"),
    *_hertz("1, limestone", "head_on_collision", LIMESTONE),
    *_hertz("2, two alloys", "chung_ooi_2", points="points.csv"),
    *(
        Entry(
            section=_CO,
            what=f"3, {name}: e_n 0.2 to 1",
            source="the e_n asked for",
            case="wall_impact",
            metric="e_n",
            models=BOTH,
            sets=(*sets, *SERIES),
            reference=restitution,
            tolerance=0.02,
        )
        for name, sets in (("aluminium oxide", ()), ("cast iron", IRON))
    ),
    _sliding("4, from 33°", "chung_ooi_4"),
    Entry(
        what="4, 5° to 40°: tangential restitution",
        metric="tangential_restitution",
        tolerance=0.015,
        scale=1.0,
        **_F4,  # type: ignore[arg-type]
        **figure(FIGURE_4_RESTITUTION, angle),  # type: ignore[arg-type]
    ),
    Entry(
        what="4, 5° to 80°: spin (over the largest)",
        metric="spin_out",
        tolerance=0.02,
        scale=617.0,
        **_F4,  # type: ignore[arg-type]
        **figure(FIGURE_4_SPIN, angle),  # type: ignore[arg-type]
    ),
    Entry(
        what="4, 5° to 80°: rebound angle of the contact point in degrees (over 90)",
        metric="contact_angle",
        value=_angle,
        tolerance=0.02,
        scale=90.0,
        **_F4,  # type: ignore[arg-type]
        **figure(FIGURE_4_ANGLE, angle),  # type: ignore[arg-type]
    ),
    _sliding("5, V > 7", "chung_ooi_5"),
    *(
        Entry(
            section=_CO,
            what=f"5, V = {span}: recoil over friction",
            source=source,
            case="chung_ooi_5",
            points="points.csv",
            metric="recoil_over_friction",
            value=lambda run: recoil(run) / 0.3,
            judged=False,
            scale=1.0,
            **figure(points, normed),  # type: ignore[arg-type]
        )
        for span, source, points in (
            ("0.33 to 6", _STICKS, FIGURE_5_RECOIL),
            ("2 to 13", "finite elements, in the same figure", FIGURE_5_FEM),
        )
    ),
    _sliding("6, s > 2.1", "chung_ooi_6"),
    *(
        Entry(
            section=_CO,
            what=f"6, {span}: recoil of the contact point (over the largest)",
            source=_READ,
            case="chung_ooi_6",
            sets=sets,
            points="points.csv",
            metric="recoil",
            value=recoil,
            tolerance=0.02,
            scale=7.13,
            **figure({x: y for x, y in FIGURE_6_RECOIL.items() if (x > 64) == gross}, angle),  # type: ignore[arg-type]
        )
        for span, gross, sets in (
            ("s > 2.1", True, ()),
            ("s = 0.47 to 1.7, sticking", False, ("contact.tangential_damping=liggghts",)),
        )
    ),
    *(
        Entry(
            section=_CO,
            what=what,
            source="symmetry",
            case="chung_ooi_7",
            sets=("needs.tangential=true",),  # else kncal leaves friction out, as it does nothing
            points="points.csv",
            metric=metric,
            models=BOTH,
            value=value,
            reference=reference,
            tolerance=1e-9,
            scale=1.0,
        )
        for what, metric, value, reference in (
            ("7: spin after over spin before", "spin_ratio", _spins, 1.0),
            (
                "7: sideways over normal speed",
                "sideways",
                lambda run: float(np.abs(_motion(run, "v")[:, :, 1:]).max() / 0.2),
                0.0,
            ),
        )
    ),
    _sliding("8 (large, stiff, heavy sphere), s > 2.1", "chung_ooi_7", "unequal_points.csv"),
]
