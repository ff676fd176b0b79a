"""The table of a sweep and its state say what the folders of its runs say."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sweeps import swept

import kncal.study.execute
import kncal.study.table
from kncal.core.errors import ReadError
from kncal.core.lock import locked, sign
from kncal.runs.workflow import load
from kncal.study import (
    execute_run,
    read_design,
    read_sweep,
    sweep_status,
)
from kncal.study.table import write_table

pytestmark = pytest.mark.slow

# --- the table --------------------------------------------------------------------------------------------------------


def test_the_table_says_what_the_runs_say(folder: Path) -> None:
    table = read_sweep(folder)
    assert len(table) == 8
    assert set(zip(table["contact.v_0"], table["run.steps_per_contact"], strict=True)) == {
        (v, n) for v in (0.5, 1.0) for n in (20, 30)
    }
    for row in table.to_dict("records"):
        data = load(folder / "runs" / row["id"] / row["model"])
        assert data.model.scene.contact.v_0 == row["contact.v_0"]
        for name, value in data.observations.metrics.items():
            assert row[name] == value
        assert (row["dt"], row["steps"]) == (data.result.dt, data.result.steps)
    linear = table[table["model"] == "linear"].set_index("id")
    hertz = table[table["model"] == "hertz"].set_index("id")
    for name in ("delta_max", "t_c", "e_n"):
        expected = (linear[name] - hertz[name]) / hertz[name]
        np.testing.assert_allclose(linear[f"difference.{name}"].astype(float), expected.astype(float), rtol=1e-12)
    assert set(linear["verdict"]) == {"open"}  # the case has no tolerance
    assert hertz["difference.e_n"].isna().all()


def test_the_file_holds_the_table(folder: Path) -> None:
    written = pd.read_csv(folder / "sweep.csv", dtype={"id": str}, keep_default_na=False)
    table = read_sweep(folder)
    assert list(written.columns) == list(table.columns)
    assert list(written["id"]) == list(table["id"])
    np.testing.assert_array_equal(written["delta_max"].astype(float), table["delta_max"])  # to the last bit


def test_the_table_is_made_from_the_results_where_its_cache_is_gone_or_wrong(folder: Path) -> None:
    before = read_sweep(folder)
    for i, path in enumerate(sorted(folder.glob("runs/*/row.json"))):
        if i % 2:
            path.unlink()
        else:
            kept = json.loads(path.read_text())
            kept["results"] = dict.fromkeys(kept["results"], "0" * 64)
            kept["rows"][0]["e_n"] = 7.0
            path.write_text(json.dumps(kept))
    pd.testing.assert_frame_equal(read_sweep(folder), before)


def test_numbers_that_could_not_be_had_are_looked_for_again(case: Path, folder: Path, monkeypatch) -> None:
    before = read_sweep(folder)
    for path in folder.glob("runs/*/row.json"):
        path.unlink()

    def fail(*_):
        raise ReadError("no memory of it")

    with monkeypatch.context() as patch:
        patch.setattr(kncal.study.table, "_numbers", fail)
        assert set(read_sweep(folder)["message"]) == {"no numbers: no memory of it"}
    pd.testing.assert_frame_equal(read_sweep(folder), before)


def test_rows_that_another_kncal_kept_are_made_anew(folder: Path, monkeypatch) -> None:
    before = read_sweep(folder)
    for path in folder.glob("runs/*/row.json"):
        kept = json.loads(path.read_text())
        kept["rows"][0]["e_n"] = 7.0
        path.write_text(json.dumps(kept))
    assert (read_sweep(folder)["e_n"] == 7.0).sum() == 4  # they are what is read, so:
    monkeypatch.setattr(kncal.study.table, "__version__", "99.0")
    pd.testing.assert_frame_equal(read_sweep(folder), before)


def test_verdicts_and_lists_in_the_table(case: Path, tmp_path: Path) -> None:
    case.write_text(case.read_text() + "\n[tolerances]\ne_n = 0.05\n")
    swept(case, tmp_path / "sweep", "tolerances.t_c=1e-9,10.0", "gravity=[0,0,-9.81],[0,0,-1.62]")
    table = read_sweep(tmp_path / "sweep")
    linear = table[table["model"] == "linear"]
    assert set(linear["verdict"][linear["tolerances.t_c"] == 10.0]) == {"within"}
    assert set(linear["verdict"][linear["tolerances.t_c"] == 1e-9]) == {"outside"}
    assert set(table["gravity"]) == {"[0, 0, -9.81]", "[0, 0, -1.62]"}


def test_parquet(case: Path, tmp_path: Path, kncal, monkeypatch) -> None:
    pytest.importorskip("pyarrow")
    out = tmp_path / "sweep"
    command = ("sweep", case, "--engine", "builtin", "--out", out, "--set", "contact.v_0=1,2", "--parquet")
    assert kncal(*command)[0] == 0
    table = pd.read_parquet(out / "sweep.parquet")
    pd.testing.assert_frame_equal(table, read_sweep(out), check_dtype=False)


def test_parquet_without_the_extra_is_refused_before_anything_runs(case: Path, tmp_path: Path, kncal, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    out = tmp_path / "sweep"
    code, _, err = kncal("sweep", case, "--engine", "builtin", "--out", out, "--set", "contact.v_0=1", "--parquet")
    assert (code, out.exists()) == (2, False)
    assert "kncal[parquet]" in err


# --- how it stands ----------------------------------------------------------------------------------------------------


def test_status_counts_and_believes_results_alone(folder: Path) -> None:
    runs = list(read_design(folder).runs)
    assert dict(sweep_status(folder).counts) == {"completed": 4}
    (folder / "runs" / runs[0] / "hertz" / "result.json").unlink()
    text = (folder / "runs" / runs[1] / "linear" / "result.json").read_text()
    failed = text.replace('"completed"', '"failed"').replace('"message": ""', '"message": "lost"')
    (folder / "runs" / runs[1] / "linear" / "result.json").write_text(failed)
    shutil.rmtree(folder / "runs" / runs[2])
    for _ in range(2):
        status = sweep_status(folder)
        assert dict(status.counts) == {"completed": 1, "unfinished": 1, "failed": 1, "waiting": 1}
        assert [(f.id, f.message) for f in status.newest] == [(runs[1], "lost")]
        (folder / "states.jsonl").unlink(missing_ok=True)  # and without what was noted
    with locked(folder / "runs" / runs[0]) as lock:
        sign(lock)
        (running,) = sweep_status(folder).running
    assert (running.id, running.pid, running.host) == (runs[0], os.getpid(), os.uname().nodename)


@pytest.mark.parametrize("junk", [b"", b"\n\n", b'{"id": "0', b"[]\n5\nnull\n{}\n", b"\xff\xfe\n", b'{"stamps": {}}\n'])
def test_notes_that_are_cut_off_or_no_notes_change_nothing(case: Path, folder: Path, junk: bytes) -> None:
    (folder / "states.jsonl").write_bytes((folder / "states.jsonl").read_bytes()[:-20] + b"\n" + junk)
    assert dict(sweep_status(folder).counts) == {"completed": 4}
    assert swept(case, folder).kept == 4


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"runs": {"../../etc": []}}'])
def test_a_design_that_is_none_is_refused(folder: Path, text: str) -> None:
    (folder / "sweep.json").write_text(text)
    for read in (sweep_status, read_sweep):
        with pytest.raises(ReadError, match=r"sweep\.json"):
            read(folder)


def test_the_table_computes_nothing_and_commands_no_terminal(folder: Path) -> None:
    """Texts of a result.json from elsewhere, by the record itself and by what was kept of it."""
    hostile = '=HYPERLINK("http://x","y")\x1b]0;z\x07'
    one, two, *_ = sorted((folder / "runs").iterdir())
    for run in (one, two):
        record = json.loads((run / "linear" / "result.json").read_text())
        record |= {"status": "failed", "failure": hostile, "message": hostile}
        (run / "linear" / "result.json").write_text(json.dumps(record))
    (two / "hertz" / "result.json").unlink()
    for _ in range(2):  # the second from what the first kept
        text = write_table(folder, read_sweep(folder)).read_text()
        assert "HYPERLINK" in text
        assert text.replace("\n", "").isprintable()
        cells = [cell for row in csv.reader(text.splitlines()) for cell in row]
        assert not [cell for cell in cells if cell.lstrip()[:1] in tuple("=+@") and cell.strip()]
    kept = json.loads((one / "row.json").read_text())
    for wrong in ({"rows": 5}, {"rows": [[1]]}, {"rows": [{"id": {"a": 1}}]}, {"rows": [{"=1": []}]}):
        (one / "row.json").write_text(json.dumps(kept | wrong))
        assert len(read_sweep(folder)) == 8


def test_a_worker_elsewhere_needs_the_folder_and_an_id(case: Path, folder: Path) -> None:
    """As a process of its own, with nothing handed over but two words; unknown ids and changed cases are failures."""
    run = next(iter(read_design(folder).runs))
    shutil.rmtree(folder / "runs" / run)
    code = (
        "import json, sys; from kncal.study import execute_run; "
        "print(json.dumps(execute_run(sys.argv[1], sys.argv[2])['status']))"
    )
    done = subprocess.run([sys.executable, "-c", code, folder, run], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == "completed"
    assert (folder / "runs" / run / "hertz" / "result.json").is_file()
    assert execute_run(folder, "0" * 12)["class"] == "damaged-result"
    (folder / "case.toml").write_text(case.read_text().replace("poisson = 0.25", "poisson = 0.3"))
    shutil.rmtree(folder / "runs" / run)
    record = execute_run(folder, run)
    assert (record["status"], "changed" in record["message"]) == ("failed", True)
    assert execute_run(folder / "nowhere", run)["class"] == "bad-input"


def test_json(case: Path, tmp_path: Path, kncal) -> None:
    out = tmp_path / "sweep"
    points = tmp_path / "points.csv"
    points.write_text("contact.v_0,contact.e_n\n0.5,0.8\n1.0,\n")
    code, told, _ = kncal("sweep", case, "--engine", "builtin", "--points", points, "--out", out, "--json")
    data = json.loads(told)
    assert code == 0
    assert (data["points"], data["runs"], data["completed"], data["failed"]) == (2, 2, 2, 0)
    table = read_sweep(out)
    assert set(table["contact.e_n"].dropna()) == {0.8}
    assert table["contact.e_n"].isna().sum() == 2
