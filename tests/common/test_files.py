"""Files of a run directory that may have come from anywhere."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from common.files import create, is_plain_directory, open_in_place, open_to_read, read_text, require_plain


def test_a_regular_file_is_read(tmp_path: Path) -> None:
    """As any other."""
    (tmp_path / "a").write_text("text")
    assert read_text(tmp_path / "a") == "text"


def test_links_and_pipes_are_not_opened(tmp_path: Path) -> None:
    """A link is not followed, and a pipe without a writer does not block."""
    (tmp_path / "a").write_text("text")
    (tmp_path / "link").symlink_to("a")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="it is a symbolic link, which is not followed"):
        open_to_read(tmp_path / "link")
    with pytest.raises(OSError, match="it is not a regular file"):
        open_to_read(tmp_path / "pipe")
    with pytest.raises(OSError, match="it is not a regular file"):
        open_to_read(tmp_path)


def test_a_file_is_made_in_the_place_of_a_link(tmp_path: Path) -> None:
    """And what the link pointed to stays as it was."""
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "new").symlink_to("victim")
    with create(tmp_path / "new") as file:
        file.write(b"content")
    assert not (tmp_path / "new").is_symlink()
    assert (read_text(tmp_path / "new"), read_text(tmp_path / "victim")) == ("content", "precious")


def test_a_file_with_another_name_is_not_changed_in_place(tmp_path: Path) -> None:
    """A hard link would carry the change elsewhere."""
    (tmp_path / "victim").write_text("precious")
    os.link(tmp_path / "victim", tmp_path / "a")
    with pytest.raises(OSError, match="it is a hard link"):
        open_in_place(tmp_path / "a", os.O_RDWR)
    os.close(open_in_place(tmp_path / "b", os.O_RDWR))


def test_a_tree_is_checked_before_it_is_written_to(tmp_path: Path) -> None:
    """At any depth: one link in it, and it is refused with that link's name."""
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "file").write_text("")
    require_plain(tmp_path)
    (tmp_path / "a" / "b" / "link").symlink_to("/etc")
    with pytest.raises(OSError, match="it is a symbolic link") as caught:
        require_plain(tmp_path)
    assert caught.value.filename == str(tmp_path / "a" / "b" / "link")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_files_of_another_user_are_refused(tmp_path: Path) -> None:
    """Who owns a file can change it while it is used."""
    (tmp_path / "a").write_text("")
    os.chown(tmp_path / "a", 12345, -1)
    with pytest.raises(OSError, match="it belongs to the user with number 12345"):
        require_plain(tmp_path)
    with pytest.raises(OSError, match="it belongs to the user with number 12345"):
        open_in_place(tmp_path / "a", os.O_RDWR)


def test_a_link_to_a_directory_is_no_plain_directory(tmp_path: Path) -> None:
    """Nor is a file, or nothing."""
    (tmp_path / "link").symlink_to(tmp_path)
    (tmp_path / "file").write_text("")
    assert is_plain_directory(tmp_path)
    assert not any(is_plain_directory(tmp_path / name) for name in ("link", "file", "nothing"))
