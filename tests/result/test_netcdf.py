"""Result files: what is written can be read again, by xarray too; a file that cannot be written or read is reported."""

import re
import resource
from pathlib import Path

import numpy as np
import pytest
import xarray

from timesim.result import file as files
from timesim.result import label
from timesim.result.dataset import dataset
from timesim.result.file import StoreError
from timesim.result.netcdf import REQUIRED_ATTRIBUTES, open_result, save, save_elsewhere

ATTRS = {
    "timesim_version": "0.1.0",
    "scene": "title: ein Schlüssel\nstudy: {kind: transient}\n",
    "study": "transient",
    "complete": True,
    "method": "tsit5",
    "compile_seconds": 1.5,
    "run_seconds": 0.25,
}
COORDS = {
    "time": np.linspace(0.0, 1.0, 5),
    "point": ["root", "tip"],
    "axis": ["x", "y", "z"],
    "contact": ["pad"],
    "component": ["t1", "t2", "n"],
    "contacts.pad.preload": [3.0, -1.0],
}


def _result(num_events: int = 2, **attrs: object) -> xarray.Dataset:
    rng = np.random.default_rng(3)
    variables = {
        "displacement": (("time", "point", "axis"), rng.normal(size=(5, 2, 3))),
        "contact_force": (("time", "contact", "component"), rng.normal(size=(5, 1, 3))),
        "contact_state": (("time", "contact"), np.array([[0], [0], [1], [2], [0]], np.int8)),
        "event_time": (("event",), np.linspace(0.1, 0.2, num_events)),
        "amplitude": (("contacts.pad.preload", "point", "axis"), np.full((2, 2, 3), np.nan)),
        "settled": (("contacts.pad.preload",), np.array([True, False])),
        "final_phase_deg": ((), np.float64(12.5)),
    }
    return dataset(variables, COORDS, ATTRS | attrs)


def test_xarray_reads_what_was_written(tmp_path: Path) -> None:
    made = _result()
    file = save(made, tmp_path / "result.nc")
    with xarray.open_dataset(file) as opened:
        xarray.testing.assert_identical(opened.load(), open_result(tmp_path))
        xarray.testing.assert_equal(opened, made)
        assert list(opened.point.values) == ["root", "tip"]
        assert set(opened.indexes) == set(COORDS)
        assert opened.sel(point="tip", axis="z").displacement.values == pytest.approx(
            made.displacement.values[:, 1, 2], abs=0
        )
        assert opened.displacement.attrs == {"long_name": "displacement", "units": "length"}
        assert opened.time.attrs["units"] == "s"
        assert opened["contacts.pad.preload"].attrs["units"] == "force"
        assert opened.contact_state.attrs["flag_meanings"].split()[2] == "separation"
        assert opened.settled.values.tolist() == [1, 0]
        assert opened.settled.dtype.kind == "i"
        assert opened.attrs == {**ATTRS, "complete": 1}


def test_a_dataset_can_be_saved_again(tmp_path: Path) -> None:
    first = open_result(save(_result(), tmp_path / "a.nc"))
    again = open_result(save(first, tmp_path / "b.nc"))
    xarray.testing.assert_identical(first, again)


def test_the_file_is_closed_after_reading(tmp_path: Path) -> None:
    file = save(_result(), tmp_path / "result.nc")
    opened = open_result(file)
    file.unlink()
    assert np.isfinite(opened.displacement.values).all()
    assert not [link for link in Path("/proc/self/fd").iterdir() if "result.nc" in str(link.resolve())]


def test_a_run_without_events_or_contacts(tmp_path: Path) -> None:
    variables = {
        "event_time": (("event",), np.zeros(0)),
        "event_contact": (("event",), np.zeros(0, int)),
        "contact_force": (("time", "contact", "component"), np.zeros((5, 0, 3))),
    }
    coords = COORDS | {"contact": np.array([], str)}
    file = save(dataset(variables, coords, ATTRS), tmp_path / "result.nc")
    with xarray.open_dataset(file) as opened:
        assert opened.sizes["event"] == 0
        assert opened.contact_force.shape == (5, 0, 3)
        assert opened.contact.dtype.kind == "U"


def test_a_long_scene_is_kept_whole(tmp_path: Path) -> None:
    scene = "mass: [1.0, 0.5]  # Maß\n" * 20_000
    opened = open_result(save(_result(scene=scene), tmp_path / "result.nc"))
    assert opened.attrs["scene"] == scene


def test_big_arrays_are_packed_and_exact(tmp_path: Path) -> None:
    time = np.linspace(0, 1, 40_000)
    wave = np.round(np.sin(7 * time), 3)
    made = dataset({"energy_input": (("time",), wave)}, {"time": time}, ATTRS)
    file = save(made, tmp_path / "result.nc")
    assert file.stat().st_size < 0.7 * (time.nbytes + wave.nbytes)
    assert (open_result(file).energy_input.values == wave).all()


def test_groups(tmp_path: Path) -> None:
    sweep = dataset(
        {"amplitude": (("frequency", "point"), np.ones((3, 2)))},
        {"frequency": [1.0, 2.0, 3.0], "point": ["root", "tip"]},
        {},
    )
    hbm = dataset({"frequency": (("solution",), np.arange(7.0))}, {}, {})
    difference = {"relative_difference": (("frequency", "point"), np.zeros((3, 2)))}
    root = dataset(difference, {"point": ["root", "tip"]}, ATTRS)
    file = save({"": root, "sweep": sweep, "hbm": hbm}, tmp_path / "result.nc")
    tree = open_result(tmp_path)
    with xarray.open_datatree(file, engine="h5netcdf") as opened:
        assert set(opened.children) == set(tree.children) == {"sweep", "hbm"}
        assert opened["hbm"]["frequency"].dims == tree["hbm"]["frequency"].dims == ("solution",)
        assert opened["sweep"]["amplitude"].shape == (3, 2)
    with xarray.open_dataset(file, group="sweep") as group:
        assert group.frequency.values.tolist() == [1.0, 2.0, 3.0]
    assert set(tree.data_vars) == {"relative_difference"}


@pytest.mark.parametrize("name", REQUIRED_ATTRIBUTES)
def test_a_missing_attribute_is_refused(tmp_path: Path, name: str) -> None:
    made = _result()
    attrs = {key: value for key, value in made.attrs.items() if key != name}
    with pytest.raises(StoreError, match=name):
        save(made.drop_attrs(deep=False).assign_attrs(attrs), tmp_path / "result.nc")
    assert not list(tmp_path.iterdir())


def test_wrong_arrays_are_refused() -> None:
    with pytest.raises(StoreError, match=r"'displacment'.*long_name.*timesim\.result\.label"):
        dataset({"displacment": (("time",), np.zeros(5))}, COORDS, ATTRS)
    with pytest.raises(ValueError, match=r"'time': length . on .* and length"):
        dataset({"energy_input": (("time",), np.zeros(4))}, COORDS, ATTRS)
    with pytest.raises(ValueError, match=r"energy_input.*Could not convert"):
        dataset({"energy_input": (("time",), np.zeros((5, 2)))}, COORDS, ATTRS)


def test_a_variable_of_no_list_brings_its_own_meaning(tmp_path: Path) -> None:
    own = {"long_name": "sound power", "units": "dB"}
    made = dataset({"loudness": (("place",), np.ones(2), own)}, {"place": (("place",), ["in", "out"], own)}, ATTRS)
    opened = open_result(save(made, tmp_path / "result.nc"))
    assert opened.loudness.attrs == opened.place.attrs == own


def test_every_name_has_a_meaning_and_units_are_known() -> None:
    texts = [label.attributes(name) for name in label.LABELS]
    assert all(text["long_name"] for text in texts)
    allowed = {"1", "s", "Hz", "degree", "length", "length/s", "modal length", "modal length/s", "force"}
    allowed |= {"force*length", "force/length", "force*length/s", "length/modal length"}
    assert {text["units"] for text in texts if "units" in text} == allowed
    assert label.attributes("excitation.forces.*.amplitude")["units"] == "force"
    assert label.attributes("structure.modes.0.mass") == {"long_name": "scene value structure.modes.0.mass"}
    for key, unit in (("forces.0", "kN"), ("constant_forces.1", "kN"), ("modal_force.0", None)):
        assert label.attributes(f"excitation.{key}.amplitude", {"force": "kN"}).get("units") == unit


def test_flags_say_what_they_mean_and_are_of_the_type_of_their_variable(tmp_path: Path) -> None:
    flags = {"settled": np.int32, "stable": np.int8, "range_cut": np.int32, "start_branch": np.int32}
    variables = {name: (("jump",), np.array([-1, 0, 1], dtype=kind)) for name, kind in flags.items()}
    result = dataset(variables, {}, ATTRS)
    for data in (result, open_result(save(result, tmp_path / "result.nc"))):
        for name, kind in flags.items():
            attrs = data[name].attrs
            assert attrs["flag_values"].dtype == kind
            assert len(attrs["flag_meanings"].split()) == len(attrs["flag_values"])
        assert data.start_branch.attrs["flag_meanings"] == "none smaller larger another irregular"
        assert data.range_cut.attrs["flag_values"].tolist() == [-1, 0, 1]


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.98])
def test_a_cut_off_file_is_refused(tmp_path: Path, keep: float) -> None:
    file = save(_result(), tmp_path / "result.nc")
    content = file.read_bytes()
    file.write_bytes(content[: int(keep * len(content)) if keep < 1 else int(keep)])
    with pytest.raises(StoreError, match=re.escape(str(file))):
        open_result(tmp_path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"no result file at .* give a file or the folder of a finished run"):
        open_result(tmp_path)
    (tmp_path / "cut" / "checkpoint").mkdir(parents=True)
    with pytest.raises(StoreError, match=r"no result file at .* has not finished; .*--resume` goes on with it"):
        open_result(tmp_path / "cut")
    (tmp_path / "text.nc").write_text("not a result")
    with pytest.raises(StoreError, match="cannot be read as a result file"):
        open_result(tmp_path / "text.nc")
    xarray.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(StoreError, match=r"not a result of timesim.*timesim_version"):
        open_result(tmp_path / "other.nc")


def test_a_full_disk_leaves_the_old_result(tmp_path: Path) -> None:
    file = save(_result(), tmp_path / "result.nc")
    before = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(StoreError, match=r"cannot be written: File too large; what was there is unchanged"):
            save(_result(method="rk4"), file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["result.nc"]


def test_an_interrupt_while_writing_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save(_result(), tmp_path / "result.nc")
    assert not list(tmp_path.iterdir())


def test_what_is_saved_without_samples_says_so_beside_why_the_run_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spare, folder = tmp_path / "spare", tmp_path / "run"
    spare.mkdir()
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(spare))
    assert len(save_elsewhere({"": _result(complete=False, reason="interrupted")}, folder)) == 2
    (whole,) = spare.iterdir()
    assert open_result(whole).attrs["reason"] == "interrupted"
    left = "interrupted; its samples are left out, for which was no room"
    assert open_result(folder).attrs["reason"] == left


def test_saving_into_no_folder(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="No such file"):
        save(_result(), tmp_path / "missing" / "result.nc")


@pytest.mark.parametrize(
    ("name", "value"),
    [("scene", 3), ("study", ["sweep", "hbm"]), ("complete", np.nan), ("complete", "yes"), ("method", 1)],
)
def test_attributes_of_another_kind_are_refused(name: str, value: object, tmp_path: Path) -> None:
    save(_result().assign_attrs({name: value}), tmp_path / "result.nc")
    with pytest.raises(StoreError, match=f"is not a result of timesim: its attribute {name} is "):
        open_result(tmp_path)


def test_groups_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    save({"": _result(), "sweep": _result().isel(point=[1])}, tmp_path / "result.nc")
    with pytest.raises(StoreError, match="is no whole result: group '/sweep' is not aligned"):
        open_result(tmp_path)
