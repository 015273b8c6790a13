"""A run to review, for the tests of the server and of the page."""

import threading

import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.review import ReviewServer, Session


def process(series, target):
    """Measure a series with the command."""
    options = ["--quiet", "--no-pictures", "--workers", "1"]
    assert main(["process", str(series), "-o", str(target), *options]) == 0
    return target


@pytest.fixture(scope="session")
def small_run(small_series, tmp_path_factory):
    """Folder with a small series and its run; copy it before you change it."""
    top = tmp_path_factory.mktemp("review") / "top"
    process(copy_of(small_series, top / "series"), top / "run")
    return top


def moved(small_run, target):
    """A copy of the folder whose run was made from the copied series."""
    copy = copy_of(small_run, target)
    record = copy / "run" / "provenance.json"
    text = record.read_text(encoding="utf-8")
    record.write_text(text.replace(str(small_run), str(copy)), encoding="utf-8")
    return copy


@pytest.fixture
def top(small_run, tmp_path):
    """A folder with series and run that a test may change."""
    return moved(small_run, tmp_path / "top")


@pytest.fixture
def session(top):
    """The session of a run."""
    session = Session(top / "run", workers=1)
    yield session
    session.close()


@pytest.fixture
def server(session):
    """The server of a session."""
    with ReviewServer(session) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield server
        server.shutdown()
