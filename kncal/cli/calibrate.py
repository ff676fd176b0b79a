"""``kncal kn``, ``kncal collide``: calibration without a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import CaseFlags, ContactFlags, EngineFlags, Json, refuse_ignored
from kncal.cli.kn_tables import MOST_TABLES, kn_data, kn_print, own_options, print_many, row_of
from kncal.cli.speeds import (
    FromRun,
    Picture,
    Uncertain,
    kn_from_run,
    print_propagation,
    propagate_pair,
    texts,
)
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.physics.material import Pair
    from kncal.scene.bed_scene import BedScene
    from kncal.scene.scene import ContactChoice, Scene

#: A block of more characters is for a file, not for a terminal: a dozen atom types.
_LONG_BLOCK = 20_000


def kn(
    case: str | None = None,
    *,
    contact: ContactFlags | None = None,
    method: Annotated[str, Parameter(help="the method whose numbers go into the LIGGGHTS block")] = "mean_overlap",
    fraction: Annotated[float, Parameter(help="allowed overlap of limited_overlap, of the diameter")] = 0.01,
    t_c: Annotated[float | None, Parameter(name="--t-c", help="duration [s] for contact_time")] = None,
    force: Annotated[float | None, Parameter(help="resting force [N] for static_load")] = None,
    factor: Annotated[float, Parameter(help="prefactor of youngs_modulus")] = 1.0,
    steps_per_contact: Annotated[
        float | None,
        Parameter(help="N of the time steps that are printed; default: as in the case, else 50, more for small e_n"),
    ] = None,
    style: Annotated[
        Literal["hooke/stiffness", "hooke", "hertz"], Parameter(help="LIGGGHTS' normal model in the block to paste")
    ] = "hooke/stiffness",
    friction: Annotated[
        float | None, Parameter(help="Coulomb friction in that block; default 0; a case holds its own")
    ] = None,
    from_run: FromRun = None,
    uncertain: Uncertain = None,
    picture: Picture = None,
    at: CaseFlags | None = None,
    by: EngineFlags | None = None,
    json: Json = False,
) -> None:
    """Linear stiffness and damping by every method, for a material given by flags or for the pairs of a CASE.

    With --from-run the impact speeds of a run are used. If contact.v_0 of CASE is "measured", the case is run first to
    measure them: by --engine, in the folder --out.

    Example: kncal kn --young 70e9 --poisson 0.22 --density 2500 --radius 1e-3 --v0 0.5 --en 0.9

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml; without it the flags describe the contact.
    """
    flags, at, by = contact or ContactFlags(), at or CaseFlags(), by or EngineFlags()
    of_options = _changed(method=method != "mean_overlap", fraction=fraction != 0.01, t_c=t_c, force=force)
    of_options += _changed(factor=factor != 1.0)
    of_block = _changed(style=style != "hooke/stiffness", friction=friction)
    of_steps = _changed(steps_per_contact=steps_per_contact)
    options = {"fraction": fraction, "factor": factor}
    options |= {name: value for name, value in (("t_c", t_c), ("force", force)) if value is not None}
    own = [*flags.given(), *(["--set"] if at.overrides else []), *([case] if case else [])]
    if from_run is not None:
        if own:
            raise InputError(f"{own[0]} and --from-run: the run's case holds these numbers: expected one or the other")
        ignored = [*of_options, *of_steps, *of_block, *by.given(), *at.given()]
        refuse_ignored("--from-run (the method is that of the run's case)", ignored)
        kn_from_run(from_run, uncertain or (), picture, json=json)
        return
    if picture is not None:
        raise InputError("--picture shows the impact speeds of a run: expected --from-run too, or leave it out")
    if case is not None:
        if given := flags.given():
            raise InputError(
                f"{given[0]} and the case {case!r}: the case holds these numbers; expected one or the other"
            )
        ignored = [flag for flag in (*of_options, *of_block) if flag in ("--method", "--friction")]
        refuse_ignored(f"the case {case!r}, which holds its own", ignored)
        scene, folder = at.load(case)
        if scene.contact.measured is None:
            _refuse_measuring(at, by)
        by.check(scene)
        _kn_case(by.measured(scene, folder), uncertain or (), options, steps_per_contact, style, json=json)
        return
    if at.overrides:
        raise InputError("--set needs a case whose values it replaces: name a case, or leave it out")
    _refuse_measuring(at, by)
    if uncertain:
        refuse_ignored("--uncertain, which gives the distribution of k_n alone", [*of_steps, *of_block])
        _kn_flags_uncertain(flags, uncertain, method, options, json=json)
        return
    _kn_flags(flags, method, options, steps_per_contact, style, friction or 0.0, json=json)


def _changed(**given: object) -> list[str]:
    """Return the flags that are given: neither None nor False."""
    return [f"--{name.replace('_', '-')}" for name, value in given.items() if value is not None and value is not False]


def _refuse_measuring(at: CaseFlags, by: EngineFlags) -> None:
    """Refuse what is for a case whose impact speed is measured, by runs."""
    for name in (*by.given(), *(["--out"] if at.out else [])):
        raise InputError(f'{name} is for a case with contact.v_0 = "measured": leave it out')


def _kn_flags(
    flags: ContactFlags,
    method: str,
    options: dict[str, Any],
    n: float | None,
    style: str,
    friction: float,
    *,
    json: bool,
) -> None:
    """Print the calibration of the contact that the flags describe."""
    from kncal.engines.liggghts.deck_block import matrix_block
    from kncal.physics.timestep import usual_steps

    pair, v_0, e_n = flags.pair(), flags.speed(), flags.restitution()
    steps = usual_steps(flags.law, e_n, flags.end) if n is None else n
    data = kn_data(pair, v_0, e_n, flags.law, flags.end, options, steps)
    matrix = flags.matrix(method, own_options(method, options))
    block = matrix_block(matrix, style, friction=friction, steps_per_contact=steps)
    if json:
        show.as_json(data | {"liggghts": block})
        return
    kn_print(flags.title(), data)
    _say_block(f"{method}, {style}", block)


class _CasePair(NamedTuple):
    """A pair of a case and what the case says about it; ``v_0`` and ``k_n`` may be None.

    It stands for ``number`` pairs of bodies that are alike (of a bed: 1).
    """

    names: tuple[str, str]
    pair: Pair
    e_n: float
    v_0: float | None
    k_n: float | None
    number: int = 1

    @property
    def name(self) -> str:
        """Both names as one."""
        return "–".join(self.names)


def _pairs(scene: Scene | BedScene) -> Iterator[_CasePair]:
    """Every pair of species of a case."""
    from kncal.scene.plan import pair_of, species_choices
    from kncal.scene.species import species_of

    species = species_of(scene)
    for which, (e_n, _, v_0, k_n) in species_choices(scene).items():
        a, b = species.bodies(which)
        yield _CasePair((a.name, b.name), pair_of(a, b), e_n, v_0, k_n, species.meetings(which))


def _kn_flags_uncertain(
    flags: ContactFlags, uncertain: Sequence[str], method: str, options: dict[str, Any], *, json: bool
) -> None:
    """Print how uncertain k_n of the contact that the flags describe is."""
    from kncal.physics.uncertainty import propagate

    material, radius, pair_of = flags.bodies()
    found = propagate(
        texts(uncertain),
        material=material,
        radius=radius,
        v_0=flags.v0,
        e_n=flags.en,
        pair_of=pair_of,
        law=flags.law,
        method=method,
        end=flags.end,
        **own_options(method, options),
    )
    if json:
        show.as_json({"method": method, "uncertain": found.to_dict()})
    else:
        print_propagation(f"{flags.title()}, {method}", found)


def _kn_case(
    scene: Scene | BedScene,
    uncertain: Sequence[str],
    options: dict[str, Any],
    n: float | None,
    style: str,
    *,
    json: bool,
) -> None:
    from kncal.engines.liggghts.deck_block import case_block

    contact = scene.contact
    merged = options | dict(contact.method_options)
    steps = scene.run.steps_per_contact if n is None else n
    result: dict[str, dict[str, Any]] = {}
    pairs = list(_pairs(scene))
    many = len(pairs) > MOST_TABLES
    if many and uncertain:
        raise InputError(
            f"{scene.name}: {len(pairs)} pairs of unlike bodies: --uncertain takes at most {MOST_TABLES}: expected a "
            "case with fewer materials, sizes and exceptions"
        )
    for p in pairs:
        only = contact.method if many else None
        data = kn_data(p.pair, p.v_0, p.e_n, contact.law, contact.end, merged, steps, only)
        if p.k_n is not None:
            data["methods"].append(_prescribed(contact, p, steps))
        result[p.name] = data | {"k_n_prescribed": p.k_n, "pairs_of_bodies": p.number}
    spreads = {p.name: propagate_pair(scene, p.names, uncertain, e_n=p.e_n, v_0=p.v_0) for p in pairs if uncertain}
    for name, spread in spreads.items():
        result[name]["uncertain"] = spread.to_dict()
    block = case_block(scene, style, steps)
    if json:
        show.as_json({"case": scene.name, "method": scene.contact.method, "pairs": result, "liggghts": block})
        return
    if many:
        print_many(scene.name, contact.method, result)
    for name, data in result.items() if not many else ():
        _kn_print_pair(name, data, contact.method)
        if name in spreads:
            show.say()
            print_propagation(f"{name}, {scene.contact.method}", spreads[name])
    _say_block(style, block)


def _say_block(what: str, block: str) -> None:
    show.say(f"For a LIGGGHTS deck ({what}):\n")
    if len(block) > _LONG_BLOCK:
        show.say(f'{len(block) // 1024} kB, too long for a terminal: --json prints it, under "liggghts"')
    else:
        show.say(block)


def _prescribed(contact: ContactChoice, p: _CasePair, steps: float) -> dict[str, Any]:
    """Return the row of a prescribed k_n: its damping, duration and time step; overlaps where a speed is known."""
    from kncal.core.errors import ValidityError
    from kncal.physics.timestep import verlet_limit
    from kncal.scene.pair_contact import PairNumbers, Rest, calibration_for, pair_contact

    numbers = PairNumbers(p.e_n, 0.0, p.v_0, p.k_n)
    try:
        calibration = calibration_for(contact, p.pair, numbers)
    except ValidityError as error:
        return {"method": "prescribed", "problem": str(error)}
    if calibration is not None:
        row = row_of(calibration, steps)
        del row["reference"]
        return row | {"method": "prescribed", "k_n": p.k_n}
    c = pair_contact(contact, p.pair, numbers, "linear", Rest(0.0, 0.0), scene="", names=p.name)
    return {
        "method": "prescribed",
        **dict.fromkeys(("kappa", "delta_max", "delta_mean", "delta_end", "dt_hertz")),
        "k_n": c.k,
        "eta_n": c.c,
        "gamma_n": c.c / c.m_eff,
        "t_c": c.t_c,
        "dt": c.t_c / steps,
        "dt_limit": float(verlet_limit(c.k, c.m_eff, c.c, 12.0)),
        "warnings": [],
    }


def _kn_print_pair(name: str, data: Mapping[str, Any], method: str) -> None:
    if data["pairs_of_bodies"] > 1:
        show.say(f"{name} stands for {data['pairs_of_bodies']} pairs of bodies that are alike:")
    kn_print(name, dict(data))
    if data["v_0"] is None:
        show.say(f"{name}: the case has no impact speed to calibrate at (contact.v_0 sets one)")
    if data["k_n_prescribed"] is not None:
        show.say(f"{name}: the case prescribes k_n = {show.quantity(data['k_n_prescribed'], 'N/m')}")
    else:
        show.say(f"{name}: the case uses the method {method}")


def collide(
    *,
    contact: ContactFlags | None = None,
    method: Annotated[str, Parameter(help="method for the stiffness of the linear contact")] = "mean_overlap",
    fraction: Annotated[float | None, Parameter(help="allowed overlap of limited_overlap, of the diameter")] = None,
    t_c: Annotated[float | None, Parameter(name="--t-c", help="duration [s] for contact_time")] = None,
    force: Annotated[float | None, Parameter(help="resting force [N] for static_load")] = None,
    factor: Annotated[float | None, Parameter(help="prefactor of youngs_modulus")] = None,
    out: Annotated[Path, Parameter(help="picture to write (.png or .svg)")] = Path("collide.png"),
    json: Json = False,
) -> None:
    """Solve one impact exactly, by the reference law and by its linear equivalent, and plot both.

    Example: kncal collide --young 70e9 --density 2500 --radius 1e-3 --v0 0.5 --en 0.7 --against wall
    """
    from kncal.physics.calibration import calibrate
    from kncal.report.collision import plot_collision

    flags = contact or ContactFlags()
    pair = flags.pair()
    given = {"fraction": fraction, "t_c": t_c, "force": force, "factor": factor}
    calibration = calibrate(
        pair,
        v_0=flags.speed(),
        e_n=flags.restitution(),
        law=flags.law,
        method=method,
        end=flags.end,
        **{name: value for name, value in given.items() if value is not None},
    )
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
    title = f"{flags.title()}: one impact at {data['v_0']:g} m/s, e_n = {data['e_n']:g}"
    show.table(title, ["", flags.law, f"linear ({method})"], rows)
    for warning in data["warnings"]:
        show.say(f"  warning: {warning['message']}")
    show.say(f"picture: {out}")
