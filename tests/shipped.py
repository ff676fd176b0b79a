"""The shipped cases by what they are: each contact by itself, a bed in a column, or many particles without gas."""

from kncal.scene.case_file import load_case, shipped_cases

_SCENES = {name: load_case(name) for name in shipped_cases()}
SINGLE = tuple(name for name, scene in _SCENES.items() if not scene.coupled)
BEDS = tuple(name for name, scene in _SCENES.items() if scene.run.coupling is not None)
GRANULAR = tuple(name for name, scene in _SCENES.items() if scene.run.sample_every is not None)
