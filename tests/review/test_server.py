"""The server without a browser: who gets what, what is written, and that nothing is lost."""

import base64
import http.client
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from review_runs import process

from contactimg.cli import main
from contactimg.effects import render_without
from contactimg.errors import InputError
from contactimg.files import read_edits, read_scene
from contactimg.review import Session
from contactimg.review.jobs import Jobs

FRAME = "frame_3.tif"
TABLES = ("contacts.csv", "frames.csv", "rejected.csv")
JSON = "application/json"


class Client:
    """Requests to a server as a browser sends them, unless told otherwise."""

    def __init__(self, address):
        self.host, self.token = re.fullmatch(r"http://([^/]+)/([^/]+)/", address).groups()

    def ask(self, method, path, body=None, *, raw=False, **headers):
        """Status, headers and body of an answer."""
        path = path if raw else f"/{self.token}/{path}"
        given = {"Host": self.host}
        if body is not None:
            given |= {"Content-Type": JSON, "Origin": f"http://{self.host}", "Content-Length": str(len(body))}
        given |= {name.replace("_", "-"): value for name, value in headers.items()}
        with closing(http.client.HTTPConnection(self.host, timeout=30)) as line:
            line.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in given.items():
                if value is not None:
                    line.putheader(name, value)
            line.endheaders(body)
            with line.getresponse() as answer:
                return answer.status, dict(answer.getheaders()), answer.read()

    def get(self, path, **headers):
        return self.ask("GET", path, **headers)

    def post(self, path, data, **headers):
        return self.ask("POST", path, json.dumps(data).encode(), **headers)


@pytest.fixture
def client(server):
    return Client(server.address)


def edit(action="exclude", x=100.0, y=120.0, **more):
    row = {"frame": FRAME, "action": action, "x_px": x, "y_px": y, "radius_px": None, "points": ""}
    return row | {"author": "AB", "time": "2024-05-03T10:00:00Z", "reason": "dust, big"} | more


def test_it_listens_on_the_loopback_address_only(server):
    assert server.server_address[0] == "127.0.0.1"


def test_the_page_and_its_parts_are_served_and_refer_to_nothing_outside(client):
    status, headers, page = client.get("")
    assert status == 200
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    for name in re.findall(r'(?:src|href)="([^"]*)"', page.decode()):
        assert name == "data:," or client.get(name)[0] == 200, name
    text = b"".join(client.get(name)[2] for name in ("", "page.js", "page.css")).decode()
    assert not re.findall(r"https?://(?!www\.w3\.org)", text)
    assert not re.findall(r"""(?:fetch|ask)\(["'`]/""", text)  # relative addresses only


@pytest.mark.parametrize(
    "path",
    [
        "../run/provenance.json",
        "..%2f..%2fetc%2fpasswd",
        "tables/../provenance.json",
        "tables/provenance.json",
        "tables//etc/passwd",
        "tables/%2e%2e/contacts.csv",
        "frames/0/../../page.js",
        "frames/-1/image.png",
        "frames/999/image.png",
        "frames/0/contact/0.png.json",
        "page.py",
        "session.py",
        "C:/windows/win.ini",
        "\\\\host\\share",
        "frames/0/image.png%00",
    ],
)
def test_nothing_else_is_served(client, path):
    status, _, body = client.get(path)
    assert status in (400, 404)
    assert b"root:" not in body
    assert b"schema_version" not in body


def test_without_the_token_there_is_nothing(client):
    for path in ("/", "/run.json", "/wrong/run.json", f"/{client.token}"):
        assert client.ask("GET", path, raw=True)[0] == 404
    assert len(client.token) >= 32


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example:80", "", "localhost@evil.example", None]
)
def test_another_host_is_refused(client, host):
    assert client.get("run.json", Host=host)[0] == 421
    assert client.post("edits/insert", {"rows": [edit()]}, Host=host)[0] in (403, 421)


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1:1", "[::1]:8765"])
def test_a_forwarded_port_works(client, session, host):
    assert client.get("run.json", Host=host)[0] == 200
    assert client.post("edits/insert", {"rows": [edit()]}, Host=host, Origin=f"http://{host}")[0] == 200
    assert len(session.edits.read()) == 1


def test_another_host_is_refused_whatever_a_header_says(client):
    rows, outside = {"rows": [edit()]}, {"Host": "hub.example.org", "Origin": "https://hub.example.org"}
    assert client.post("edits/insert", rows, **outside)[0] == 421
    kept = {"Host": "localhost:8765", "Origin": outside["Origin"], "X_Forwarded_Host": outside["Host"]}
    assert client.post("edits/insert", rows, **kept)[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": None},
        {"Origin": "https://localhost"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {"Content_Type": "text/plain"},
    ],
)
def test_a_foreign_page_can_write_nothing(client, session, headers):
    status, _, _ = client.post("edits/insert", {"rows": [edit()]}, **headers)
    assert status == 403
    assert not session.edits.path.exists()


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"{", 400),
        (b"[]", 400),
        (b'{"rows": 3}', 400),
        (b'{"rows": [{"x_px": "1"}]}', 400),
        (b"[" * 90_000, 400),
    ],
)
def test_what_is_no_edit_is_refused(client, session, body, status):
    assert client.ask("POST", "edits/insert", body)[0] == status
    assert not session.edits.path.exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"action": "delete"}, "unknown action"),
        ({"x_px": None}, "needs x_px and y_px"),
        ({"x_px": math.inf}, "needs x_px and y_px"),
        ({"frame": "frame_9.tif"}, "there is no frame 'frame_9.tif'"),
        ({"action": "add"}, "needs a positive radius_px"),
    ],
)
def test_an_edit_that_says_too_little_is_refused(client, session, change, sentence):
    status, _, body = client.post("edits/insert", {"rows": [edit() | change]})
    assert status == 400
    assert sentence in json.loads(body)["error"]
    assert not session.edits.path.exists()


def test_a_large_or_endless_request_is_refused(client):
    for length in (str(2**21), "x", "-1"):
        assert client.ask("POST", "edits/insert", b"{}", Content_Length=length)[0] == 413


def test_edits_are_inserted_and_taken_out_and_other_rows_keep_their_text(client, session):
    by_hand = "frame;action;x_px;y_px;note\nframe_1.tif;exclude;12,50;010;mine\n"
    session.edits.path.write_text(by_hand, encoding="utf-8")
    run = json.loads(client.post("edits/insert", {"rows": [edit(reason="two\nlines")]})[2])
    assert [row["x_px"] for row in run["edits"]] == [12.5, 100.0]
    assert [frame["pending"] for frame in run["frames"]] == [True, False, True]
    assert [frame["n_edits"] for frame in run["frames"]] == [1, 0, 1]
    lines = session.edits.path.read_text(encoding="utf-8").splitlines()
    assert lines[1].startswith("frame_1.tif;exclude;12,50;010;mine")
    assert "two lines" in lines[2]
    assert client.post("edits/insert", {"rows": [edit(x=7.0)], "place": 0})[0] == 200
    assert session.edits.read()["x_px"].tolist() == [7.0, 12.5, 100.0]
    wrong = client.post("edits/remove", {"row": edit(x=8.0), "place": 0})
    assert wrong[0] == 400
    assert "no longer has this edit" in json.loads(wrong[2])["error"]
    assert client.post("edits/remove", {"row": edit(x=7.0), "place": 0})[0] == 200
    assert session.edits.path.read_text(encoding="utf-8").splitlines() == lines


def test_an_edit_is_taken_out_wherever_another_page_has_moved_it(client, session):
    rows = [edit(x=x, time=time) for x, time in ((1.0, "a"), (2.0, "b"), (1.0, "a"), (3.0, "c"))]
    session.edits.insert(pd.DataFrame(rows))
    # seen at the places 3 and 2 before the first row was taken out
    assert client.post("edits/remove", {"row": rows[0], "place": 0})[0] == 200
    assert client.post("edits/remove", {"row": rows[3], "place": 3})[0] == 200
    assert session.edits.read()["x_px"].tolist() == [2.0, 1.0]
    assert client.post("edits/remove", {"row": rows[2], "place": 2})[0] == 200
    assert session.edits.read()["x_px"].tolist() == [2.0]


def test_an_edit_that_is_sent_twice_is_written_once(client, session):
    for _ in range(2):
        assert client.post("edits/insert", {"rows": [edit()]})[0] == 200
    assert len(session.edits.read()) == 1


def test_measuring_again_gives_the_tables_of_process(client, session, top):
    contacts = json.loads(client.get("frames/2/contacts.json")[2])["contacts"]
    x, y = contacts["x_px"], contacts["y_px"]
    corner = " ".join(map(str, (x[5] - 9, y[5] - 9)))
    rows = [
        edit(x=x[0], y=y[0]),
        edit("split", x[3], y[3]),
        edit("mask", None, None, points=f"{corner};{x[5] + 9} {y[5] - 9};{x[5]} {y[5] + 9}", frame="*"),
        edit("add", 20.0, 20.0, radius_px=4.0, frame="frame_1.tif"),
    ]
    before = {name: client.get(f"tables/{name}")[2] for name in TABLES}
    assert before == {name: (top / "run" / name).read_bytes() for name in TABLES}
    client.post("edits/insert", {"rows": rows})
    assert client.post("measure", {})[0] == 200
    assert session.jobs.wait().error == ""
    process(top / "series", top / "batch")
    for name in TABLES:
        assert client.get(f"tables/{name}")[2] == (top / "batch" / name).read_bytes()
    assert client.get("tables/contacts.csv")[2] != before["contacts.csv"]
    run = json.loads(client.get("run.json")[2])
    assert not any(frame["pending"] for frame in run["frames"])
    # the run itself is not written
    assert {name: (top / "run" / name).read_bytes() for name in TABLES} == before


def test_frames_without_new_edits_are_not_measured_again(client, session, monkeypatch):
    names = {source.read().image.tobytes(): source.name for source in session.open().frames}
    measured, measure_image = set(), render_without.measure_image

    def recorded(image, *arguments, **options):
        if np.isnan(options["optics"].contrast):  # not the second time, with the contrast of the series
            measured.add(names[image.tobytes()])
        return measure_image(image, *arguments, **options)

    monkeypatch.setattr(render_without, "measure_image", recorded)
    for rows in ([], [edit(frame="frame_1.tif", x=5.0, y=5.0)], [edit(x=6.0, y=6.0)]):
        client.post("edits/insert", {"rows": rows})
        measured.clear()
        session.measure()
        assert session.jobs.wait().error == ""
        assert measured == (set(names.values()) if not rows else {rows[0]["frame"]})


def test_curves_are_those_of_process_and_calibrate(top):
    for name in ("frame_1.tif", "frame_2.tif"):
        (top / "series" / name).unlink()
    options = ["--quiet", "--workers", "1", "-o"]
    with closing(Session(top / "run", workers=1)) as session:
        curves = session.curves(0)
    t = curves["thresholds"]
    pixel_size = json.loads((top / "run" / "provenance.json").read_text())["pose"]["pixel_size_m"]
    k, out = 30, top / "threshold"
    method = ["--method", "threshold", "--threshold", str(t[k]), "--no-pictures"]
    # 1: the only frame may carry a status at an unusual threshold
    assert main(["process", str(top / "series"), *method, *options, str(out)]) in (0, 1)
    radius = pd.read_csv(out / "contacts.csv")["radius_px"]
    assert len(radius) == curves["counts"][k]
    assert np.pi * (radius**2).sum() * pixel_size**2 == pytest.approx(curves["areas"][k], rel=1e-12)
    out = top / "plateau"
    assert main(["calibrate", "plateau", str(top / "series"), *options, str(out)]) == 0
    curve, record = pd.read_csv(out / "curve.csv"), json.loads((out / "calibration.json").read_text())
    assert curve["threshold"].tolist() == t
    # the pose, and with it the size of a pixel, is fitted anew
    np.testing.assert_allclose(curve["area_m2"], curves["scanned_areas"], rtol=1e-3)
    names = ("threshold_low", "threshold", "threshold_high")
    assert list(curves["plateau"]) == [record[name]["value"] for name in names]


def test_a_chosen_threshold_goes_into_the_scene_file_and_nothing_else_changes(client, session, top):
    scene = top / "series" / "scene.toml"
    measure = '[measure] # how\npose = "fit"  # the contacts say\nfilm_doubt = 0.0\n'
    text = scene.read_text(encoding="utf-8").replace("[measure]\nfilm_doubt = 0.0\n\n", "") + "\n" + measure
    scene.write_text(text, encoding="utf-8")
    assert client.post("threshold", {"threshold": 0.4})[0] == 200
    assert scene.read_text(encoding="utf-8") == text + 'method = "threshold"\nthreshold = 0.4\n'
    assert read_scene(scene).measure.threshold == 0.4
    session.measure()
    assert session.jobs.wait().error == ""
    process(top / "series", top / "batch")
    for name in TABLES:
        assert client.get(f"tables/{name}")[2] == (top / "batch" / name).read_bytes()
    for value in (0, 1.5, "x", None):
        assert client.post("threshold", {"threshold": value})[0] == 400


def test_the_window_of_a_contact_shows_what_the_model_leaves(session):
    """Residual of a fitted contact: noise; of one moved by 1.5 px: clearly more."""
    contacts = session.shown.tables[FRAME].contacts
    label = int(contacts.loc[contacts["radius_px"].idxmax(), "label"])

    def residual():
        window = session.window(2, label)
        parts = [np.frombuffer(base64.b64decode(window[name]), "<i2") for name in ("pixels", "model")]
        return float(np.std(parts[0] / 1000 - parts[1] / 1000) / window["noise"])

    fitted = residual()
    row = contacts["label"] == label
    contacts.loc[row, "x_px"] += 1.5
    assert fitted < 1.6  # pixels share noise, contacts have shot noise
    assert residual() > 2 * fitted


def test_tables_changed_after_the_run_are_named_and_summed_anew(top):
    lines = (top / "run" / "contacts.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (top / "run" / "contacts.csv").write_text("".join(lines[:-3]), encoding="utf-8")
    before = pd.read_csv(top / "run" / "frames.csv")["n_contacts"].iloc[2]
    with closing(Session(top / "run", workers=1)) as session:
        assert session.record()["changed"] == ["contacts.csv"]
        assert session.record()["frames"][2]["n_contacts"] == before - 3
        session.measure()
        session.jobs.wait()
        assert session.record()["changed"] == []
        assert session.record()["frames"][2]["n_contacts"] == before


def test_runs_that_cannot_be_reviewed_are_refused(top, tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        Session(tmp_path)
    assert (
        main(["predict", str(top / "series"), "--load-N", "0.01", "-o", str(top / "model"), "--quiet"]) == 0
    )
    with pytest.raises(InputError, match="holds no run of `contactimg process`"):
        Session(top / "model")


def test_links_out_of_the_run_are_not_followed(top, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (top / "series" / FRAME).rename(elsewhere / FRAME)
    (top / "series" / FRAME).symlink_to(elsewhere / FRAME)
    with pytest.raises(InputError, match="which the run was not made from"):
        Session(top / "run")
    (top / "series" / FRAME).unlink()
    (elsewhere / FRAME).rename(top / "series" / FRAME)
    (elsewhere / "secret.csv").write_text("password\n")
    (top / "series" / "edits.csv").symlink_to(elsewhere / "secret.csv")
    with pytest.raises(InputError, match="is a link"):
        Session(top / "run")


def test_a_job_that_is_cancelled_or_fails_says_so():
    jobs, started = Jobs(), threading.Event()

    def endless(advance):
        while True:
            started.set()
            advance()
            time.sleep(0.001)

    def failing(_advance):
        raise InputError("no frame")

    assert jobs.start(endless, total=3)
    started.wait(10)
    assert not jobs.start(endless, total=3)
    jobs.close()
    assert jobs.wait(10).error == "cancelled"
    jobs.start(failing, total=1)
    assert jobs.wait(10).error == "no frame"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_every_edit_that_was_acknowledged_outlives_a_killed_server(top, rng):
    """Killed while edits are sent one after the other: what was acknowledged is on the disk."""
    command = [sys.executable, "-m", "contactimg", "review", str(top / "run"), "--no-browser"]
    acknowledged = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:  # noqa: S603
        client = Client(server.stdout.readline().split()[-1])
        threading.Timer(rng.uniform(0.3, 0.6), server.send_signal, [signal.SIGKILL]).start()
        for k in range(10_000):
            try:
                assert client.post("edits/insert", {"rows": [edit(x=float(k), time=str(k))]})[0] == 200
            except (OSError, http.client.HTTPException):
                break
            acknowledged.append(float(k))
    edits = read_edits(top / "series" / "edits.csv")
    written = edits["x_px"].tolist()
    assert acknowledged
    assert written[: len(acknowledged)] == acknowledged
    assert len(written) <= len(acknowledged) + 1
    assert all(second == first + 1 for first, second in pairwise(written))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_control_c_ends_it_cleanly_while_it_measures(top):
    command = [sys.executable, "-m", "contactimg", "review", str(top / "run"), "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # a shell in the background ignores Ctrl-C, and its processes inherit that
    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        server = subprocess.Popen(command, **pipes)  # noqa: S603
    finally:
        signal.signal(signal.SIGINT, ignored)
    try:
        client = Client(server.stdout.readline().split()[-1])
        assert client.post("measure", {})[0] == 200
        server.send_signal(signal.SIGINT)
        out, complaints = server.communicate(timeout=60)
    finally:
        server.kill()
    assert server.returncode == 0
    assert "review ended" in out
    assert complaints == ""
    assert not list(Path(top / "run").glob("*.part"))
