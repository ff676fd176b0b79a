"""What a file is that somebody took for a case: by its name and its first lines."""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import NamedTuple


class _Kind(NamedTuple):
    what: str
    names: str
    text: str


#: The first that fits counts; ``names`` is tried on the file's name, ``text`` on its beginning.
_KINDS = (
    _Kind("a LIGGGHTS or LAMMPS script", r"(in\..*|.*\.(in|lmp|liggghts))", r"(atom_style|pair_style|units|fix)\s"),
    _Kind("a surface mesh (STL)", r".*\.stl", r"solid\b.*\n\s*facet\b"),
    _Kind("an MFiX project", r".*\.mfx|mfix\.dat", r"(run_name|description)\s*=\s*'"),
    _Kind("a dictionary of OpenFOAM", r"controlDict|fvSchemes|fvSolution|blockMeshDict", r"FoamFile\b"),
    _Kind("a dump of LIGGGHTS or LAMMPS", r"dump.*|.*\.dump", r"ITEM: TIMESTEP"),
    _Kind("a file for ParaView (VTK)", r".*\.(vtk|vt[pui]|pvd)", r"# vtk DataFile|<VTKFile"),
    _Kind("a Python script (of YADE?)", r".*\.py", r"(from|import) \w+"),
    _Kind("JSON", r".*\.json", r"\s*\{\s*\""),
    _Kind("YAML", r".*\.ya?ml", r"---\s"),
    _Kind("a table (CSV)", r".*\.csv", r"[\w .]+(,[\w .]+)+\n"),
)
#: So much of a file is looked at, line by line; comments before the first statement of a deck are often long.
HEAD = 8192


def kind_of_file(name: str, text: str) -> str:
    """Return what the file of that name and beginning is, in words; "" if nobody knows."""
    base = PurePath(name).name
    lines = text[:HEAD].lstrip("\ufeff \r\n\t")
    by_name = next((k.what for k in _KINDS if re.fullmatch(k.names, base, re.IGNORECASE)), "")
    by_text = next((k.what for k in _KINDS if re.search(rf"(?m)^[ \t]*(?:{k.text})", lines, re.IGNORECASE)), "")
    return by_name or by_text
