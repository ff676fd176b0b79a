"""What ``kncal kn`` does with the speeds of a run (``--from-run``) and with uncertain inputs (``--uncertain``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from kncal.cli import show
from kncal.core.errors import InputError, ReadError

if TYPE_CHECKING:
    from kncal.observe.impact_speeds import ImpactSpeeds
    from kncal.physics.material import Material, Pair
    from kncal.physics.statistics import Interval
    from kncal.physics.uncertainty import Distribution, Propagation
    from kncal.runs.impact_speeds import RunSpeeds
    from kncal.scene.bodies import Body, Particle
    from kncal.scene.contact import ContactChoice

FromRun = Annotated[
    Path | None,
    Parameter(
        name="--from-run",
        help="run folder of a case or of one model: calibrate at the impact speeds that it had",
    ),
]
Uncertain = Annotated[
    list[str] | None,
    Parameter(
        name="--uncertain",
        help="an uncertain input: KEY=5%, KEY=LOW:HIGH or KEY=log:LOW:HIGH; prints the distribution of k_n; KEY: "
        "young, poisson, density, radius, e_n, v_0 (may be repeated); with --from-run v_0 is as measured",
    ),
]
Picture = Annotated[
    Path | None,
    Parameter(name="--picture", help="with --from-run: picture of the impact speeds (.png or .svg)"),
]


def kn_from_run(folder: Path, uncertain: Sequence[str], picture: Path | None, *, json: bool) -> None:
    """Print the impact speeds of a run and k_n at them."""
    from kncal.report.speeds import WHO, plot_impact_speeds
    from kncal.runs.impact_speeds import run_speeds
    from kncal.runs.records import MANIFEST
    from kncal.scene.model import KINDS

    if not folder.is_dir():
        raise ReadError(f"{folder}: no such folder; expected a run folder, e.g. runs/wall_impact")
    found = [folder / kind for kind in KINDS if (folder / kind / MANIFEST).is_file()] or [folder]
    runs = [run_speeds(path) for path in found]
    if picture is not None:
        main = runs[0]
        plot_impact_speeds(main.speeds, picture, f"{main.scene.name}, {main.model}: impact speeds")
    spreads = [_spreads_of_run(run, uncertain) if uncertain else {} for run in runs]
    if json:
        data = [
            run.to_dict() | {"folder": str(path), "uncertain": {k: p.to_dict() for k, p in spread.items()}}
            for run, path, spread in zip(runs, found, spreads, strict=True)
        ]
        show.as_json({"case": runs[0].scene.name, "method": runs[0].scene.contact.method, "runs": data})
        return
    for run, spread in zip(runs, spreads, strict=True):
        _print_run(run)
        for kind, propagation in spread.items():
            print_propagation(f"{WHO.get(kind, kind)}, {run.model}", propagation)
    if picture is not None:
        show.say(f"picture: {picture}")


def _print_run(run: RunSpeeds) -> None:
    from kncal.observe.impact_speeds import KINDS_OF_IMPACTS, STATISTICS
    from kncal.report.speeds import WHO

    contact = run.scene.contact
    for kind, found in run.speeds.items():
        pair = run.pairs[kind]
        window = f"{show.quantity(run.begin, 's')} to {show.quantity(run.end, 's')}"
        if not found.count:
            show.say(f"{run.scene.name}, {run.model}, {WHO.get(kind, kind)}: no impact in {window}\n")
            continue
        rows = []
        doubts: dict[str, list[str]] = {}
        for row in run.stiffness(kind):
            stiffness = row.problem if row.k_n is None else row.k_n.shown("N/m")
            rows.append([STATISTICS[row.statistic], row.v_0.shown("m/s"), stiffness])
            for why in filter(None, row.v_0.why.split("; ")):
                doubts.setdefault(why, []).append(STATISTICS[row.statistic])
        who = WHO[kind] if kind in KINDS_OF_IMPACTS else "–".join(pair.names)
        show.table(
            f"{run.scene.name}, {run.model}, {who}: {found.count} impacts in {window}",
            ["impact speed", "v_0 (95 %)", f"k_n by {contact.method} (95 %)"],
            rows,
        )
        for why, names in doubts.items():
            show.say(f"  not reliable ({', '.join(names)}): {why}")
        at = "no speed" if pair.contact.v_0 is None else show.quantity(pair.contact.v_0, "m/s")
        given = "" if pair.numbers.k_n is None else f"; it prescribes k_n = {show.quantity(pair.numbers.k_n, 'N/m')}"
        show.say(f"  the run was calibrated at {at}{given}\n")
    if run.enduring is not None:
        show.say(
            f"  contacts of two particles last {run.enduring.duration:.3g} t_c on average; at any time at least "
            f"{100.0 * run.enduring.share:.0f} % of them are older than an impact: no impact speed describes them\n"
        )


def _spreads_of_run(run: RunSpeeds, uncertain: Sequence[str]) -> dict[str, Propagation]:
    """Propagate the measured speeds and what else is uncertain, for each kind of impacts."""
    from kncal.scene.species import species_of

    spreads, species = {}, species_of(run.scene)
    for kind, found in run.speeds.items():
        if found.count:
            pair = run.pairs[kind]
            bodies = species.bodies(species.pair_of(pair.names))
            spreads[kind] = propagate_pair(run.scene.contact, bodies, uncertain, found, e_n=pair.numbers.e_n)
    return spreads


def propagate_pair(
    contact: ContactChoice,
    bodies: tuple[Particle, Body],
    uncertain: Sequence[str],
    measured: ImpactSpeeds | None = None,
    *,
    e_n: float,
    v_0: float | None = None,
) -> Propagation:
    """Propagate the uncertainty of the first of two bodies of a case; a second of the same material varies with it."""
    from kncal.physics.material import pair, wall_pair
    from kncal.physics.uncertainty import propagate

    a, b = bodies
    same, radius_2 = b.material == a.material, getattr(b, "radius", None)  # a wall has none

    def meet(material: Material, radius: Any) -> Pair:
        other = material if same else b.material
        if radius_2 is None:
            return wall_pair(material, radius, other)
        return pair(material, radius, other, radius if same and radius_2 == a.radius else radius_2)

    given: dict[str, str | Distribution] = {} if measured is None else {"v_0": measured}
    options: dict[str, Any] = dict(contact.options)
    return propagate(
        given | texts(uncertain),
        material=a.material,
        radius=a.radius,
        v_0=v_0,
        e_n=e_n,
        pair_of=meet,
        law=contact.law,
        method=contact.method,
        end=contact.end,
        **options,
    )


def texts(uncertain: Sequence[str]) -> dict[str, str]:
    """Return KEY -> text of every ``KEY=TEXT``."""
    found: dict[str, str] = {}
    for text in uncertain:
        key, sign, value = text.partition("=")
        if not sign:
            raise InputError(f"--uncertain {text}: expected KEY=5%, KEY=LOW:HIGH or KEY=log:LOW:HIGH")
        if key in found:
            raise InputError(f"--uncertain {text}: {key} is given twice: expected one distribution")
        found[key] = value
    return found


def print_propagation(title: str, found: Propagation) -> None:
    """Print the quantiles of k_n and the shares of its variance."""
    rows = [[f"{100.0 * share:g} %", value.shown("N/m")] for share, value in found.quantiles.items()]
    show.table(f"{title}: distribution of k_n ({found.samples} samples)", ["quantile", "k_n (95 %)"], rows)
    shares: Mapping[str, Interval] = found.total
    rows = [
        [name, f"{100.0 * found.first_order[name].value:.1f} %", f"{100.0 * total.value:.1f} %", total.why]
        for name, total in sorted(shares.items(), key=lambda item: -item[1].value)
    ]
    show.table("share of the variance of ln k_n", ["input", "by itself", "in all", ""], rows, text=(0, 3))
