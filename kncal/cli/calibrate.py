"""``kncal kn``, ``kncal collide``, ``kncal laws``: calibration without a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.errors import InputError

if TYPE_CHECKING:
    from kncal.material import Material, Pair

Young = Annotated[float | None, Parameter(name="--young", help="Young's modulus E [Pa]")]
Poisson = Annotated[float, Parameter(name="--poisson", help="Poisson's ratio")]
Density = Annotated[float | None, Parameter(name="--density", help="density [kg/m³]")]
Radius = Annotated[float | None, Parameter(name="--radius", help="radius of the sphere [m]")]
Speed = Annotated[float | None, Parameter(name=["--v0", "--v-0"], help="normal impact speed [m/s]")]
Restitution = Annotated[
    float | None, Parameter(name=["--en", "--e-n"], help="normal coefficient of restitution, in (0, 1]")
]
Law = Annotated[str, Parameter(name="--law", help="reference law, see `kncal laws`")]
End = Annotated[
    Literal["overlap", "force"], Parameter(name="--end", help="contact ends at zero overlap or at zero force")
]
Against = Annotated[
    Literal["sphere", "wall", "rigid-wall"],
    Parameter(name="--against", help="a second sphere, a wall of a material, or a rigid wall"),
]
Young2 = Annotated[float | None, Parameter(name="--young-2", help="of the second sphere or the wall")]
Poisson2 = Annotated[float | None, Parameter(name="--poisson-2", help="of the second sphere or the wall")]
Density2 = Annotated[float | None, Parameter(name="--density-2", help="of the second sphere or the wall")]
Radius2 = Annotated[float | None, Parameter(name="--radius-2", help="of the second sphere [m]")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="print data for machines")]

_COLUMNS = (
    ("k_n", "N/m"),
    ("eta_n", "N s/m"),
    ("kappa", ""),
    ("t_c", "s"),
    ("delta_max", "m"),
    ("delta_mean", "m"),
)


def kn(
    case: str | None = None,
    *,
    young: Young = None,
    poisson: Poisson = 0.25,
    density: Density = None,
    radius: Radius = None,
    v0: Speed = None,
    en: Restitution = None,
    law: Law = "tsuji",
    end: End = "overlap",
    against: Against = "sphere",
    young_2: Young2 = None,
    poisson_2: Poisson2 = None,
    density_2: Density2 = None,
    radius_2: Radius2 = None,
    method: Annotated[str, Parameter(help="the method whose numbers go into the LIGGGHTS block")] = "mean_overlap",
    fraction: Annotated[float, Parameter(help="allowed overlap of limited_overlap, of the diameter")] = 0.01,
    t_c: Annotated[float | None, Parameter(name="--t-c", help="duration [s] for contact_time")] = None,
    force: Annotated[float | None, Parameter(help="resting force [N] for static_load")] = None,
    factor: Annotated[float, Parameter(help="prefactor of youngs_modulus")] = 1.0,
    steps_per_contact: Annotated[float, Parameter(help="N of the advised time steps")] = 50.0,
    json: Json = False,
) -> None:
    """Linear stiffness and damping by every method, for a material given by flags or for the pairs of a CASE.

    Example: kncal kn --young 70e9 --poisson 0.22 --density 2500 --radius 1e-3 --v0 0.5 --en 0.9

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml; without it the flags describe the contact.
    """
    options = {"fraction": fraction, "factor": factor}
    options |= {name: value for name, value in (("t_c", t_c), ("force", force)) if value is not None}
    if case is not None:
        given = {"--young": young, "--density": density, "--radius": radius, "--v0": v0, "--en": en}
        _refuse_both(case, given)
        _kn_case(case, options, steps_per_contact, json=json)
        return
    pair = _pair(young, poisson, density, radius, against, young_2, poisson_2, density_2, radius_2)
    speed, restitution = _needed("--v0", v0), _needed("--en", en)
    block = _block(
        _material(young, poisson, density),
        _needed("--radius", radius),
        speed,
        restitution,
        law,
        method,
        end,
        options,
    )
    data = _kn_data(pair, speed, restitution, law, end, options, steps_per_contact)
    if json:
        show.as_json(data | {"liggghts": block})
        return
    _kn_print("sphere on sphere" if against == "sphere" else against.replace("-", " "), data)
    show.say(f"For a LIGGGHTS deck with this sphere (type 1) and walls of its material (type 2), {method}:\n")
    show.say(block)


def _kn_case(case: str, options: dict[str, Any], steps: float, *, json: bool) -> None:
    from kncal.case_file import load_case
    from kncal.planning import pair_choice, pair_of

    scene = load_case(case)
    result: dict[str, dict[str, Any]] = {}
    for a, b in scene.body_pairs():
        e_n, _, v_0, k_n = pair_choice(scene, a, b)
        if v_0 is None:
            result[f"{a.name}–{b.name}"] = {"k_n_prescribed": k_n, "methods": []}
            continue
        merged = options | dict(scene.contact.method_options)
        contact = scene.contact
        result[f"{a.name}–{b.name}"] = _kn_data(pair_of(a, b), v_0, e_n, contact.law, contact.end, merged, steps) | {
            "k_n_prescribed": k_n
        }
    if json:
        show.as_json({"case": scene.name, "method": scene.contact.method, "pairs": result})
        return
    for name, data in result.items():
        if data["methods"]:
            _kn_print(name, data)
        else:
            show.say(
                f"{name}: nothing moves towards anything, so there is no speed to calibrate at (contact.v_0 sets one)"
            )
        if data["k_n_prescribed"] is not None:
            show.say(f"{name}: the case prescribes k_n = {show.quantity(data['k_n_prescribed'], 'N/m')}")
        else:
            show.say(f"{name}: the case uses the method {scene.contact.method}")


def _kn_data(
    pair: Pair, v_0: float, e_n: float, law: str, end: Any, options: dict[str, Any], steps: float
) -> dict[str, Any]:
    from kncal.calibration import calibrate
    from kncal.errors import ValidityError
    from kncal.methods import METHODS
    from kncal.timestep import advise_time_step

    rows: list[dict[str, Any]] = []
    reference: dict[str, Any] = {}
    for name, row in METHODS.items():
        own = {k: v for k, v in options.items() if k in (*row.required, *(row.optional or {}))}
        missing = [k for k in row.required if k not in own]
        if missing:
            rows.append({"method": name, "problem": f"needs --{missing[0].replace('_', '-')}"})
            continue
        try:
            c = calibrate(pair, v_0=v_0, e_n=e_n, law=law, method=name, end=end, **own)
        except ValidityError as error:
            rows.append({"method": name, "problem": str(error)})
            continue
        advice = advise_time_step(c, steps)
        data = c.to_dict()
        reference = data.pop("reference")
        rows.append(
            {
                **data,
                "gamma_n": float(c.gamma_n),
                "dt": float(advice.linear),
                "dt_hertz": float(advice.hertz),
                "dt_limit": float(advice.linear_limit),
            }
        )
    return {
        "law": law,
        "end": end,
        "v_0": v_0,
        "e_n": e_n,
        "reference": reference,
        "steps_per_contact": steps,
        "methods": rows,
    }


def _kn_print(name: str, data: dict[str, Any]) -> None:
    reference, n = data["reference"], data["steps_per_contact"]
    title = f"{name}: reference {data['law']}, e_n = {data['e_n']:g}, v_0 = {data['v_0']:g} m/s"
    columns = ["method", *(c for c, _ in _COLUMNS), f"dt (N={n:g})"]
    rows = []
    warnings: dict[str, list[str]] = {}
    for row in data["methods"]:
        if "problem" in row:
            rows.append([row["method"], row["problem"]] + [""] * (len(columns) - 2))
            continue
        rows.append(
            [
                row["method"],
                *(show.quantity(row[c], unit) for c, unit in _COLUMNS),
                show.quantity(row["dt"], "s"),
            ]
        )
        for warning in row["warnings"]:
            warnings.setdefault(warning["message"], []).append(row["method"])
    if reference:
        dt = next(r["dt_hertz"] for r in data["methods"] if "problem" not in r)
        rows.append(
            [
                f"({data['law']})",
                "",
                "",
                "",
                *(show.quantity(reference[c], u) for c, u in _COLUMNS[3:]),
                show.quantity(dt, "s"),
            ]
        )
    show.table(title, columns, rows)
    valid = sum("problem" not in row for row in data["methods"])
    for message, methods in warnings.items():
        who = "all methods" if len(methods) == valid else ", ".join(methods)
        show.say(f"  warning ({who}): {message}")
    show.say(f"  contact ends at zero {data['end']}; the paper's three methods as reconstructed\n")


def _block(
    material: Material,
    radius: float,
    v_0: float,
    e_n: float,
    law: str,
    method: str,
    end: Any,
    options: dict[str, Any],
) -> str:
    from kncal.matrix import calibrate_matrix
    from kncal.methods import get_method

    row = get_method(method)
    own = {k: v for k, v in options.items() if k in (*row.required, *(row.optional or {}))}
    matrix = calibrate_matrix(
        {"sphere": (material, radius)},
        {"wall": material},
        v_0=v_0,
        e_n=e_n,
        law=law,
        method=method,
        end=end,
        **own,
    )
    limit = "limitForce on" if end == "force" else "limitForce off: the contact ends at zero overlap"
    return f"# hooke/stiffness, {limit}\n{matrix.liggghts()}"


def collide(
    *,
    young: Young = None,
    poisson: Poisson = 0.25,
    density: Density = None,
    radius: Radius = None,
    v0: Speed = None,
    en: Restitution = None,
    law: Law = "tsuji",
    end: End = "overlap",
    against: Against = "sphere",
    young_2: Young2 = None,
    poisson_2: Poisson2 = None,
    density_2: Density2 = None,
    radius_2: Radius2 = None,
    method: Annotated[str, Parameter(help="how the linear contact is found")] = "mean_overlap",
    out: Annotated[Path, Parameter(help="picture to write (.png or .svg)")] = Path("collide.png"),
    json: Json = False,
) -> None:
    """Solve one impact exactly, by the reference law and by its linear equivalent, and plot both.

    Example: kncal collide --young 70e9 --density 2500 --radius 1e-3 --v0 0.5 --en 0.7 --against wall
    """
    from kncal.calibration import calibrate
    from kncal.collision import plot_collision

    pair = _pair(young, poisson, density, radius, against, young_2, poisson_2, density_2, radius_2)
    calibration = calibrate(pair, v_0=_needed("--v0", v0), e_n=_needed("--en", en), law=law, method=method, end=end)
    plot_collision(calibration, out)
    data = calibration.to_dict()
    if json:
        show.as_json(data | {"picture": str(out)})
        return
    rows = [
        [name, show.quantity(data["reference"][name], unit), show.quantity(data[name], unit)]
        for name, unit in (("t_c", "s"), ("delta_max", "m"), ("delta_mean", "m"), ("delta_end", "m"))
    ]
    rows.append(["stiffness", show.quantity(float(pair.k_h), "N/m^1.5"), show.quantity(data["k_n"], "N/m")])
    show.table(
        f"one impact at {data['v_0']:g} m/s, e_n = {data['e_n']:g}",
        ["", law, f"linear ({method})"],
        rows,
    )
    for warning in data["warnings"]:
        show.say(f"  warning: {warning['message']}")
    show.say(f"picture: {out}")


def laws(*, json: Json = False) -> None:
    """List the contact laws and the methods for k_n, with sources and limits."""
    from kncal.contact.registry import LAWS
    from kncal.methods import METHODS

    if json:
        show.as_json(
            {
                "laws": [{"name": w.name, "title": w.title, "source": w.source, "note": w.note} for w in LAWS.values()],
                "methods": [
                    {k: getattr(m, k) for k in ("name", "title", "source", "keeps", "loses", "avoid")}
                    for m in METHODS.values()
                ],
            }
        )
        return
    show.table(
        "Contact laws",
        ["law", "what it is", "source"],
        [[w.name, f"{w.title}. {w.note}", w.source] for w in LAWS.values()],
        text=(0, 1, 2),
        fold=True,
    )
    show.table(
        "Methods for k_n",
        ["method", "keeps equal", "does not keep", "not for"],
        [[m.name, m.keeps, m.loses, m.avoid] for m in METHODS.values()],
        text=(0, 1, 2, 3),
        fold=True,
    )


def _needed(flag: str, value: float | None) -> float:
    if value is None:
        raise InputError(f"{flag} is missing: give the contact by flags (see `kncal kn --help`) or name a case")
    return value


def _refuse_both(case: str, given: dict[str, float | None]) -> None:
    both = [flag for flag, value in given.items() if value is not None]
    if both:
        raise InputError(f"{both[0]} and the case {case!r}: the case holds these numbers; expected one or the other")


def _material(young: float | None, poisson: float, density: float | None) -> Material:
    from kncal.material import Material

    return Material(young=_needed("--young", young), poisson=poisson, density=_needed("--density", density))


def _pair(
    young: float | None,
    poisson: float,
    density: float | None,
    radius: float | None,
    against: str,
    young_2: float | None,
    poisson_2: float | None,
    density_2: float | None,
    radius_2: float | None,
) -> Pair:
    from kncal.material import Material, pair, wall_pair

    first = _material(young, poisson, density)
    r = _needed("--radius", radius)
    second = None
    if any(value is not None for value in (young_2, poisson_2, density_2)):
        second = Material(
            young=first.young if young_2 is None else young_2,
            poisson=first.poisson if poisson_2 is None else poisson_2,
            density=first.density if density_2 is None else density_2,
        )
    if against == "sphere":
        return pair(first, r, second, radius_2)
    if radius_2 is not None:
        raise InputError(
            f"--radius-2 = {radius_2:g}: a wall is flat; expected no second radius with --against {against}"
        )
    if against == "rigid-wall":
        return wall_pair(first, r, None)
    return wall_pair(first, r, second or first)
