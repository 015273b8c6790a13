"""A process killed before any of its file operations: the result folder is the old one or the new one."""

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from contactimg.errors import InputError
from contactimg.files import OutputFolder, finish_commit
from contactimg.files.output import PENDING_FOLDER, read_settled

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

RECORD = {"schema_version": 1, "command": "contactimg process a", "configuration": {"options": {}}}
OLD = {"a.csv": "old", "b.csv": "old", "pictures/gone.png": "old", "pictures/both.png": "old"}
NEW = {"a.csv": "new", "b.csv": "new", "pictures/both.png": "new", "more/c.csv": "new"}
OPERATIONS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod"}


def write(folder, files):
    with OutputFolder(folder, RECORD) as out:
        for name, text in files.items():
            (out.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (out.folder / name).write_text(text)


def killed_at(number, folder, work, *, stop=signal.SIGKILL):
    """Run ``work`` in a child that is stopped before its file operation ``number``; False if it has fewer."""
    child = os.fork()
    if child:
        return os.WIFSIGNALED(os.waitpid(child, 0)[1])
    count = 0

    def count_operation(event, arguments):
        nonlocal count
        if event in OPERATIONS and str(arguments[0]).startswith(str(folder)):
            count += 1
            if count == number:
                os.kill(os.getpid(), stop)

    code = 1
    try:
        sys.addaudithook(count_operation)
        work()
        code = 0
    except KeyboardInterrupt:
        code = 0
    finally:
        os._exit(code)


def visible(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def outputs(folder):
    files = visible(folder)
    record = json.loads(files.pop("provenance.json"))
    assert sorted(files) == record["outputs"]
    return files


def hidden(folder):
    return [path.name for path in folder.rglob(".*")]


def test_killed_before_any_file_operation(tmp_path):
    seen = set()
    for number in range(1, 200):
        out = tmp_path / f"out{number}"
        write(out, OLD)
        if not killed_at(number, out, lambda out=out: write(out, NEW)):
            break
        found = read_settled(out, lambda out=out: outputs(out))
        assert found in (OLD, NEW), number
        assert not (out / PENDING_FOLDER).exists()
        seen.add(found == NEW)
        write(out, NEW | {"a.csv": "newest"})
        assert outputs(out) == NEW | {"a.csv": "newest"}
        assert hidden(out) == []
    assert seen == {True, False}
    assert number > 20


def test_killed_again_while_the_commit_is_completed(tmp_path):
    def stopped(out, number):
        write(out, OLD)
        (out / "more").mkdir()
        (out / "more" / "c.csv").write_text("mine")
        return killed_at(number, out, lambda: write(out, NEW))

    first = next(
        number
        for number in range(1, 200)
        if stopped(tmp_path / f"first{number}", number)
        and (tmp_path / f"first{number}" / PENDING_FOLDER).exists()
    )
    for number in range(1, 100):
        out = tmp_path / f"out{number}"
        assert stopped(out, first + number % 5)
        again = killed_at(number, out, lambda out=out: finish_commit(out))
        finish_commit(out)
        found = visible(out)
        assert found.pop("more/c.csv.bak") == "mine"
        assert {name: found[name] for name in NEW} == NEW
        assert "pictures/gone.png" not in found
        if not again:
            break
    assert number > 10


def test_asked_to_end_before_any_file_operation(tmp_path):
    from contactimg.engine.processes import ending_cleanly

    def work(out):
        with ending_cleanly():
            write(out, NEW)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    seen = set()
    for number in range(1, 60, 2):
        out, stop = tmp_path / f"out{number}", (signal.SIGINT, signal.SIGTERM)[number // 2 % 2]
        write(out, OLD)
        assert not killed_at(number, out, lambda out=out: work(out), stop=stop), number
        assert hidden(out) == [], number
        found = outputs(out)
        assert found in (OLD, NEW), number
        seen.add(found == NEW)
    assert seen == {True, False}


def test_a_reader_that_meets_a_commit_reads_again(tmp_path):
    out, runs = tmp_path / "out", iter([NEW])
    write(out, OLD)

    def read():
        first = (out / "a.csv").read_text()
        for files in runs:
            write(out, files)
        return first, (out / "b.csv").read_text()

    assert read_settled(out, read) == ("new", "new")


def test_a_commit_that_cannot_be_completed_is_one_sentence(tmp_path):
    out = tmp_path / "out"
    write(out, OLD)
    (out / PENDING_FOLDER).mkdir()
    (out / PENDING_FOLDER / "provenance.json").write_text(json.dumps(RECORD | {"outputs": ["../x"]}))
    with pytest.raises(InputError, match=r"provenance\.json: is damaged; delete .* and repeat the run"):
        finish_commit(out)


def test_a_folder_in_the_place_of_a_file_is_refused_before_anything_changes(tmp_path):
    out = tmp_path / "out"
    write(out, OLD)
    (out / "more").write_text("a file of a person")
    with pytest.raises(InputError, match="more: is a file, where the run needs a folder"):
        write(out, NEW)
    assert outputs_besides(out, "more") == OLD


def outputs_besides(folder: Path, name):
    files = visible(folder)
    del files["provenance.json"], files[name]
    return files
