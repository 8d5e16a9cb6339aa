"""A benchmark compares what the README's tour says with the results; here, that nothing escapes it."""

import importlib
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import timesim
from timesim.scene.source import read
from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```yaml\n(.*?)```", README, re.S)


@pytest.fixture
def tour(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    yield importlib.import_module("tour")
    sys.modules.pop("tour", None)


def test_every_number_of_the_tour_is_compared(tour: ModuleType):
    assert list(tour.faults_of_the_text(README)) == []
    changed = README.replace("235 transitions", "235 events, 7 of them at once")
    assert next(tour.faults_of_the_text(changed)) == (
        "the README does not say once: near its best preload: # cycles, # transitions"
    )
    (fault,) = tour.faults_of_the_text(README.replace("625 transitions", "625 transitions in 3 s"))
    assert fault.startswith("nothing checks 3 in: a finite element blade")


def test_the_rows_are_the_scenes_that_are_there(tour: ModuleType):
    rows = tour.rows(README)
    names = [row.name for row in rows]
    assert len(set(names)) == len(names) >= 20
    assert {claim.row for claim in tour.CLAIMS} <= set(names)
    for row in rows:
        assert (ROOT / row.arguments[0]).is_file(), row
    assert rows[1].arguments[1:] == ("--set", "contacts.pad.preload=-4", "--set", "excitation.frequency=0.947")


@pytest.mark.long
def test_the_scene_to_paste_slips_and_peaks_as_it_says():
    text = BLOCKS[0]
    sentence = r"peak is (\S+) mm at (\S+) Hz.*?slips for (\S+) % of the\s+cycle and dissipates (\S+) W"
    says = re.search(sentence, README, re.S)
    assert says is not None
    peak, frequency, share, power = map(float, says.groups())
    values = [frequency - 0.25, frequency, frequency + 0.25]
    point = timesim.run(text, overrides={"study.frequency": {"values": values}}).squeeze()
    amplitude = 1e3 * point["amplitude"].sel(point="tip", axis="z").values
    assert np.argmax(amplitude) == 1
    assert amplitude[1] == pytest.approx(peak, abs=5e-4)
    assert point["slip_share"].values[1] == pytest.approx(share / 100, abs=5e-3)
    assert point["dissipated_power"].values[1] == pytest.approx(power, abs=5e-4)


SECTIONS = [part for block in BLOCKS[1:] for part in block.split("\n\n")]


@pytest.mark.parametrize("section", SECTIONS, ids=[" ".join(part.split()[:4]) for part in SECTIONS])
def test_the_sections_to_paste_are_those_of_a_scene(section: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Put into a scene that has the points and contacts which they name, with the lines that are commented out."""
    given = read(re.sub(r"^ {,4}# (?=\w+: )", "  ", section, flags=re.M)).data
    base = read(ROOT / "configs" / "oscillator.yaml").data
    if "structure" in given:
        source = given["structure"]
        points = source.get("matrices", source)["points"]
        forces = [{"point": name, "direction": [1, 0, 0], "amplitude": 1} for name in points]
        base |= {"contacts": [], "excitation": {"frequency": 1, "forces": forces}}
        shutil.copy(ROOT / "tests" / "data" / "blade.npz", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_scene(base | given).model().structure.num_modes > 1


@pytest.mark.parametrize(
    ("printed", "right", "wrong"),
    [
        ("0.4297", 0.42974, 0.42976),
        ("235", 235, 234),
        ("3.3e-5", 3.34e-5, 3.36e-5),
        ("-4", -4, 4),
        ("0.9470", 0.947, 0.948),
    ],
)
def test_a_number_is_right_to_its_printed_digits(tour: ModuleType, printed: str, right: float, wrong: float):
    assert not tour.off(printed, right)
    assert tour.off(printed, wrong)
    assert tour.off(printed, float("nan"))


def test_times_are_a_table_that_names_what_takes_too_long(tour: ModuleType):
    table = tour.report({"a.yaml": (59.0, 50.0, 31.0, 5.0), "b.yaml": (61.0, 80.0, 9.0, 8.0)}, (0.1, 1.0))
    assert table.splitlines()[-2:] == [
        "| a.yaml | 59.0 | 50.0 | 31.0 (too long) | 5.0 |",
        "| b.yaml | 61.0 (too long) | 80.0 | 9.0 | 8.0 |",
    ]
