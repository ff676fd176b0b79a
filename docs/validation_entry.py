"""One comparison of docs/validation.md: a case, a metric, and a reference with its source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from kncal.observe.run_data import RunData
from kncal.scene.scene import Scene

BOTH = ("linear", "hertz")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One comparison.

    Attributes
    ----------
    section, what, source : heading of the table, what is compared, and with what
    case, sets, points : shipped case, ``KEY=VALUE,VALUE,...`` of a grid, and a file of points in its folder: of several
        runs the worst is shown
    metric : of `kncal.scene.metrics`, or a name of its own with ``value``
    models : contact models that are run
    only : which of the scenes are meant
    value, unit : the number of a run, if it is no metric
    reference : number, or function of the scene; None: of the case's expected.json
    tolerance : allowed deviation; None: that of expected.json
    scale : what a deviation is divided by; None: the reference
    judged : False: shown without a verdict
    long : takes more than some CPU seconds
    """

    section: str
    what: str
    source: str
    case: str
    metric: str
    models: tuple[str, ...] = ("hertz",)
    sets: tuple[str, ...] = ()
    points: str = ""
    only: Callable[[Scene], bool] = lambda scene: True
    value: Callable[[RunData], float] | None = None
    unit: str = ""
    reference: float | Callable[[Scene], float] | None = None
    tolerance: float | None = None
    scale: float | None = None
    judged: bool = True
    long: bool = False

    @property
    def name(self) -> str:
        """The key in the store."""
        return "/".join((self.case, self.metric, *self.models, *self.sets, self.points, self.what))


def expected(section: str, what: str, case: str, metric: str, source: str, *models: str, long: bool = False) -> Entry:
    """Return the entry of a metric that the case's expected.json has, for these models (none: both)."""
    return Entry(section=section, what=what, source=source, case=case, metric=metric, models=models or BOTH, long=long)
