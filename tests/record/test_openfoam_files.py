"""Files of OpenFOAM: every bit kept on the way out and in; damage is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kncal.core.errors import InputError, ReadError
from kncal.record import openfoam

numbers = st.floats(allow_nan=False, width=64)
lists = st.one_of(
    arrays(np.float64, st.integers(0, 20), elements=numbers),
    arrays(np.float64, st.tuples(st.integers(0, 20), st.just(3)), elements=numbers),
    arrays(np.int32, st.integers(0, 20), elements=st.integers(-(2**31), 2**31 - 1)),
)
same_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
HEAD = 'FoamFile\n{{\n    version 2.0;\n    format {};\n    class x;\n    arch "LSB;label=32;scalar=64";\n}}\n'


@same_folder
@given(values=lists)
def test_lists_come_back_to_the_bit(tmp_path: Path, values: np.ndarray) -> None:
    path = tmp_path / "list"
    openfoam.write_list(path, values)
    found = openfoam.read_list(path)
    assert found.shape == values.shape
    assert found.tobytes() == values.tobytes()


@same_folder
@given(values=lists, data=st.data())
def test_a_list_cut_off_anywhere_is_refused(tmp_path: Path, values: np.ndarray, data: st.DataObject) -> None:
    path = tmp_path / "list"
    openfoam.write_list(path, values)
    raw = path.read_bytes()
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw) - 3))])  # up to the closing bracket
    if len(values):
        with pytest.raises(ReadError, match="list"):
            openfoam.read_list(path)


@pytest.mark.parametrize("values", [np.zeros((2, 2, 2)), np.zeros((2, 3), dtype=int), np.array(["a"]), np.array(1.0)])
def test_what_is_no_list_is_not_written(tmp_path: Path, values: np.ndarray) -> None:
    if values.ndim == 2 and values.dtype.kind == "i":
        values = values.reshape(-1, 3, 1)
    with pytest.raises(InputError, match="expected scalars"):
        openfoam.write_list(tmp_path / "list", values)


def field(inside: np.ndarray, patch: np.ndarray) -> bytes:
    """A volume field as the solver writes it, with all that a reader may stumble over in the binary part."""
    text = HEAD.format("binary").encode() + b"// * * * //\n\ndimensions      [0 2 -2 0 0 0 0];\n\n"
    text += (
        b"internalField   nonuniform List<scalar> \n%d\n(" % inside.size + inside.astype("<f8").tobytes() + b")\n;\n"
    )
    text += b"\nboundaryField\n{\n    inlet\n    {\n        type            fixedFluxPressure;\n"
    text += b"        gradient        nonuniform List<scalar> \n%d\n(" % patch.size + (-patch).astype("<f8").tobytes()
    text += (
        b")\n;\n        value           nonuniform List<scalar> \n%d\n(" % patch.size + patch.astype("<f8").tobytes()
    )
    text += (
        b')\n;\n    }\n    outlet\n    {\n        type fixedValue;\n        value uniform 2.5;\n    }\n    "side.*"\n'
    )
    text += b"    {\n        type slip;\n        value nonuniform List<scalar> 0();\n    }\n}\n\n// *** //\n"
    return text


@same_folder
@given(inside=arrays(np.float64, st.integers(1, 9), elements=numbers), patch=arrays(np.float64, 4, elements=numbers))
def test_fields_are_read_by_counting(tmp_path: Path, inside: np.ndarray, patch: np.ndarray) -> None:
    # Values whose bytes look like syntax
    tricky = np.frombuffer(b"};\nvalue;{(uniform 3;)}}", dtype="<f8")
    inside = np.concatenate([inside, tricky])
    path = tmp_path / "p"
    path.write_bytes(field(inside, patch))
    assert openfoam.read_cells(path, inside.size).tobytes() == inside.tobytes()
    assert openfoam.read_patch(path, "inlet", 4).tobytes() == patch.tobytes()
    assert openfoam.read_patch(path, "outlet", 7).tolist() == [2.5] * 7
    data = openfoam.read_field(path)
    assert data["boundaryField"]["inlet"]["type"] == "fixedFluxPressure"
    assert data["dimensions"] == "[0 2 -2 0 0 0 0]"
    assert data["boundaryField"]["side.*"]["value"].size == 0
    with pytest.raises(ReadError, match=f"{inside.size} values, expected 99"):
        openfoam.read_cells(path, 99)
    with pytest.raises(ReadError, match="no patch 'lid'"):
        openfoam.read_patch(path, "lid", 4)
    with pytest.raises(ReadError, match="no numbers"):
        openfoam.read_patch(path, "side.*", 4)


@same_folder
@given(cut=st.integers(1, 600))
def test_a_field_cut_off_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "p"
    raw = field(np.arange(20.0), np.arange(4.0))
    end = raw.index(b"// ***")
    path.write_bytes(raw[: end - 2 - min(cut, end - 10)])
    with pytest.raises(ReadError, match="p: "):
        openfoam.read_patch(path, "inlet", 4)
        openfoam.read_patch(path, "outlet", 4)
        openfoam.read_field(path)


def test_a_uniform_entry_is_rewritten_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "U.air"
    inside = np.arange(30.0).reshape(-1, 3)
    head = HEAD.format("binary").encode() + b"internalField nonuniform List<vector> 10(" + inside.tobytes() + b");\n"
    tail = b"boundaryField\n{\n    outlet { type x; value uniform (0 0 1); }\n    inlet\n    {\n"
    tail += b"        value uniform %s;\n    }\n}\n"
    path.write_bytes(head + tail % b"(0 0 1)")
    openfoam.set_patch_vector(path, "inlet", "value", (0.0, -1.5, 1.0 / 3.0))
    assert path.read_bytes() == head + tail % b"(0.0 -1.5 0.3333333333333333)"
    assert openfoam.read_patch(path, "inlet", 2)[1].tolist() == [0.0, -1.5, 1.0 / 3.0]
    with pytest.raises(ReadError, match="no entry 'inletVelocity'"):
        openfoam.set_patch_vector(path, "inlet", "inletVelocity", (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "no FoamFile header"),
        (HEAD.format("gzip").encode(), "expected ascii or binary"),
        (HEAD.format("binary").replace("label=32", "label=64").encode(), "32-bit labels"),
        (HEAD.format("ascii").encode() + b"internalField nonuniform List<scalar> 2(1 2);", "writeFormat binary"),
        (HEAD.format("binary").encode() + b"internalField nonuniform List<word> 2(a b);", "list of word"),
        (HEAD.format("binary").encode() + b"internalField uniform abc;", "no numbers"),
        (HEAD.format("binary").encode() + b"dimensions [0];", "no numbers"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: bytes, words: str) -> None:
    path = tmp_path / "p"
    path.write_bytes(text)
    with pytest.raises(ReadError, match=words):
        openfoam.read_cells(path, 2)
    with pytest.raises(ReadError, match="cannot be read"):
        openfoam.read_cells(tmp_path / "nothing", 2)


def test_the_error_of_a_log_is_found(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert openfoam.fatal_error(log) == ""
    log.write_bytes(
        b"Time = 1\n" * 20000
        + b"\n--> FOAM FATAL ERROR: \nno \xff such\x1b[2J patch\n\n    From x\n\nFOAM exiting\n\nmore\n"
    )
    message = openfoam.fatal_error(log)
    assert message.startswith("--> FOAM FATAL ERROR: / no ") and message.endswith("patch / From x")
    assert message.isprintable()
    log.write_text("Time = 1\n#1 Foam::sigFpe::sigHandler(int)\n")
    assert "sigFpe" in openfoam.fatal_error(log)
