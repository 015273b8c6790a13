"""A run to review, for the tests of the server and of the page."""

import threading

import pytest
from review_runs import moved, process
from small_series import SCENE, write_small_series

from contactimg.review import ReviewServer, Session

FEW = SCENE | {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0007, 0.0007]},
    "asperities": SCENE["asperities"] | {"side_m": 0.0014},
    "simulate": SCENE["simulate"] | {"loads_N": [0.005, 0.01, 0.02], "shape": [220, 230]},
}
"""About thirty contacts on each frame."""


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """Folder with a small series and its run; copy it before you change it."""
    top = tmp_path_factory.mktemp("review") / "top"
    process(write_small_series(top / "series", FEW), top / "run")
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
