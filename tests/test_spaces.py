"""Maps of a study on a template: damaged files are refused with a code, and nothing in them is run."""

import numpy as np
import pytest
from commands import refused
from made_spaces import VERTS, write_space

from morphofold.errors import DamagedFile, MissingPart, UnknownName
from morphofold.group.spaces import find_space
from morphofold.tables import write_table

SUBJECTS, N = 6, len(VERTS)


@pytest.fixture
def group(tmp_path, rng):
    maps = {f"{hemi}.{name}": rng.uniform(1, 2, (SUBJECTS, N)) for hemi in ("lh", "rh") for name in ("H", "area")}
    names = write_space(tmp_path / "study", maps)
    rows = [{"participant_id": name, "age": 20.5 + 7 * k} for k, name in enumerate(names)]
    write_table(tmp_path / "study" / "participants.tsv", ("participant_id", "age"), rows)
    return tmp_path / "study" / "spaces" / "ball" / "group"


def npz(path):
    np.savez(path.with_suffix(".npz"), H=np.zeros((SUBJECTS, N)))
    path.with_suffix(".npz").rename(path)


class Made:
    """What makes a file when it is unpickled."""

    def __reduce__(self):
        return open, ("made", "w")


def save(values):
    return lambda path: np.save(path, values, allow_pickle=True)


DAMAGE = {
    "empty": lambda path: path.write_bytes(b""),
    "half": lambda path: path.write_bytes(path.read_bytes()[:5000]),
    "npz": npz,
    "code": save(np.full((SUBJECTS, N), Made())),
    "words": save(np.full((SUBJECTS, N), "2.5")),
    "one row": save(np.zeros(N)),
    "too many subjects": save(np.zeros((SUBJECTS + 1, N))),
    "other vertices": save(np.zeros((SUBJECTS, N - 1))),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_file_that_is_no_map_of_the_subjects_is_refused(group, monkeypatch, tmp_path, damage):
    monkeypatch.chdir(tmp_path)
    damage(group / "lh.H.npy")
    with pytest.raises(DamagedFile):
        find_space(tmp_path / "study").map("lh", "H")
    assert not (tmp_path / "made").exists()


def test_a_map_of_one_side_only_is_not_an_unknown_one(group, tmp_path):
    (group / "lh.H.npy").unlink()
    space = find_space(tmp_path / "study")
    with pytest.raises(MissingPart):
        space.map("lh", "H")
    assert space.map("rh", "H").shape == (SUBJECTS, N)
    with pytest.raises(UnknownName):
        space.map("lh", "K")
    with pytest.raises(UnknownName):
        space.map("lh", "../group/rh.H")


@pytest.mark.parametrize("change", [("s01", "s02"), ("rh", "side"), ("participant_id", "id"), ("s0", "n/a\ts0")])
def test_a_damaged_list_of_subjects_is_refused(group, tmp_path, change):
    text = (group / "participants.tsv").read_text()
    (group / "participants.tsv").write_text(text.replace(*change))
    with pytest.raises(DamagedFile):
        find_space(tmp_path / "study")


def test_a_list_without_subjects_is_refused(group, tmp_path):
    (group / "participants.tsv").write_text("participant_id\tlh\trh\n")
    with pytest.raises(DamagedFile):
        find_space(tmp_path / "study")


def test_the_command_refuses_it_and_writes_nothing(group, tmp_path, capsys):
    argv = [
        "stats",
        str(tmp_path / "study"),
        "--model",
        "H ~ age",
        "--contrast",
        "age",
        "-o",
        str(tmp_path / "out"),
        "-q",
    ]
    DAMAGE["code"](group / "rh.H.npy")
    refused(capsys, argv, "damaged-file", "rh.H.npy")
    (group / "lh.H.npy").unlink()
    refused(capsys, argv, "missing-part", "lh.H.npy")
    assert not (tmp_path / "out").exists()
