"""Files appear whole or not at all."""

import pytest

from clunk.results.files import reason, write_whole


def test_a_file_is_replaced_by_what_was_written(tmp_path):
    (tmp_path / "a").write_bytes(b"old and longer")
    write_whole(tmp_path / "a", lambda target: target.write(b"new"))
    assert (tmp_path / "a").read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_halfway_leaves_the_old_file_and_no_other(tmp_path, error):
    (tmp_path / "a").write_bytes(b"old")

    def write(target):
        target.write(b"half")
        raise error

    with pytest.raises(type(error)):
        write_whole(tmp_path / "a", write)
    assert (tmp_path / "a").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_through_a_link_the_file_is_replaced_and_not_the_link(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "link").symlink_to("a")
    write_whole(tmp_path / "link", lambda target: target.write(b"new"))
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a").read_bytes() == b"new"


def test_a_missing_directory_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_whole(tmp_path / "none" / "a", lambda target: target.write(b""))


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device"), "no space left on device"),
        (ValueError("Two\n  lines."), "two lines"),
        (MemoryError(), "MemoryError"),
    ],
)
def test_a_reason_can_stand_within_a_sentence(error, words):
    assert reason(error).lower() == words.lower()
