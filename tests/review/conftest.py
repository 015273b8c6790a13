"""A run to review, for the tests of the server and of the page."""

import threading

import pytest
from review_runs import moved, process
from small_series import copy_of

from contactimg.review import ReviewServer, Session


@pytest.fixture(scope="session")
def small_run(small_series, tmp_path_factory):
    """Folder with a small series and its run; copy it before you change it."""
    top = tmp_path_factory.mktemp("review") / "top"
    process(copy_of(small_series, top / "series"), top / "run")
    return top


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
