"""The shipped cases by what they are: each contact by itself, or many particles coupled in intervals."""

from kncal.scene.case_file import load_case, shipped_cases

SINGLE = tuple(name for name in shipped_cases() if not load_case(name).coupled)
BEDS = tuple(name for name in shipped_cases() if load_case(name).coupled)
