"""What the viewer costs the servo, and how old its picture is: figures of this machine, beside its load.

    python benchmarks/viewer.py [--seconds 120] [--pairs 5] [--start] [--browser]

* age: time.monotonic() at a client less the time of each sample when it arrives (one client, simulated
  session); samples that were left out in that time; beside it, how late a process goes on that only sleeps.
* servo: p99 of the absolute period error with five clients, one of them hung, against none, in interleaved
  sessions; medians of both.  ``--thread`` serves from a thread of the session's owner instead of a process.
* start (``--start``): from the start of ``tissueid render --no-browser`` as a process to the second frame of
  samples at a websocket client that runs already, with an empty and a warm cache of compiled functions.
* picture (``--browser``): from the same start until requestAnimationFrame has drawn the second sample, in a
  chromium that runs already (its own start is the browser's affair), and p99 of the age of the sample behind
  each picture and pictures a second, drawn without a graphics card.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from websockets.sync.client import connect

from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.session import Session
from tissueid.viewer.frames import read_frame
from tissueid.viewer.hello import show_session
from tissueid.viewer.serving import ServedViewer, ViewerOptions

S_TO_MS = 1e3
CLIENT = "--client"
#: A page is there before a session is started [s].
SETTLE_S = 2.0
#: Caches of compiled functions a start is measured with; warm ones belong to this checkout.
STARTS = ("empty", "empty", "warm", "warm", "warm", "warm", "warm")


def load() -> str:
    """What else this machine does."""
    return f"load {os.getloadavg()[0]:.1f}"


def sleeper(seconds: float) -> None:
    """A process that does nothing but sleep 10 ms at a time: how late this machine lets it go on [ms]."""
    late = []
    begun = time.monotonic()
    while (now := time.monotonic()) - begun < seconds:
        time.sleep(0.01)
        late.append(S_TO_MS * (time.monotonic() - now - 0.01))
    sys.stdout.write(json.dumps(late))


def one_client(url: str, seconds: float, *, hung: bool) -> None:
    """A client in a process of its own: prints ages [ms] and what was left out."""
    ages: list[float] = []
    dropped = frames = 0
    with connect(url, max_size=None, compression=None) as link:
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            if hung and frames:
                time.sleep(0.2)
                continue
            with contextlib.suppress(TimeoutError):
                data = link.recv(0.5)
                if isinstance(data, bytes):
                    arrived = time.monotonic()
                    frame = read_frame(data)
                    frames += 1
                    dropped = frame.dropped
                    if arrived - begun > 1.0:
                        ages += (arrived - frame.samples["time_s"]).tolist()
                    link.send(json.dumps({"v": 1, "answer": frames}))
    sys.stdout.write(json.dumps({"ages_ms": [round(S_TO_MS * age, 3) for age in ages], "dropped": dropped}))


@contextlib.contextmanager
def threaded_viewer() -> Iterator[Any]:
    """The server in a thread of the owner, to compare with."""
    import socket

    from tissueid.viewer.frames import LiveFeed
    from tissueid.viewer.hello import hello
    from tissueid.viewer.security import Access
    from tissueid.viewer.server import Stage, ViewerServer

    listening = socket.create_server(("127.0.0.1", 0))
    port, stage = listening.getsockname()[1], Stage()
    server = ViewerServer(stage, Access("127.0.0.1", port))

    class Threaded:
        url = f"http://127.0.0.1:{port}/"

        def show(self, plan: Any, servo: Any) -> None:
            stage.show_live(hello(plan.head), LiveFeed(servo.ring))

    thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[listening])))
    thread.start()
    yield Threaded()
    server.should_exit = True
    thread.join()


@contextlib.contextmanager
def spawned_viewer() -> Iterator[Any]:
    """The server as it is used."""
    with ServedViewer(ViewerOptions()) as viewer:

        class Spawned:
            url = viewer.url

            def show(self, plan: Any, servo: Any) -> None:
                show_session(viewer, plan, servo, None)

        yield Spawned()


def session(
    seconds: float, clients: int, *, hung: int = 0, thread: bool = False
) -> tuple[dict[str, Any], list[Any]]:
    """A simulated session with clients; its summary and what they found."""
    plan = plan_session(RenderOptions(preset="paper-a", device="sim", seconds=seconds + 3.0, led=True))
    found: list[Any] = []
    with threaded_viewer() if thread else spawned_viewer() as viewer:
        url = viewer.url.replace("http", "ws") + "ws"
        running: list[subprocess.Popen[str]] = []

        def watch(servo: Any) -> None:
            viewer.show(plan, servo)
            for number in range(clients):
                words = [sys.executable, __file__, CLIENT, url, str(seconds), str(int(number < hung))]
                running.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))

        outcome = Session(plan, watch=watch).run()
        found = [json.loads(one.communicate()[0]) for one in running]
    return outcome.summary, found


@contextlib.contextmanager
def started(cache: str) -> Iterator[tuple[str, float]]:
    """``tissueid render`` without arguments: its address, and when it was started."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder} if cache == "empty" else dict(os.environ)
        command = [sys.executable, "-m", "tissueid", "render", "--no-browser", "--seconds", "60"]
        begun = time.monotonic()
        running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        assert running.stderr is not None
        try:
            yield running.stderr.readline().split()[1], begun
        finally:
            running.terminate()
            running.communicate()


def start_times() -> None:
    """Start to moving data at a client."""
    for cache in STARTS:
        with started(cache) as (url, begun), connect(url.replace("http", "ws") + "ws", max_size=None) as link:
            frames = 0
            while frames < 2:
                data = link.recv()
                frames += isinstance(data, bytes) and read_frame(data).samples.size > 0
            took = time.monotonic() - begun
        print(f"start to moving data at a client, {cache} cache: {took:.2f} s, {load()}")


def picture_age() -> None:
    """Start to picture, and the age of pictures, in chromium without a graphics card."""
    from playwright.sync_api import sync_playwright

    # as where there is no graphics card: pages are painted, and scenes drawn, by the processor
    flags = ["--no-sandbox", "--enable-unsafe-swiftshader"]
    with sync_playwright() as engine:
        browser = engine.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
        for cache in STARTS:
            page = browser.new_page(viewport={"width": 1400, "height": 900})
            time.sleep(SETTLE_S)
            with started(cache) as (url, begun):
                # it listens before it says so: what is asked of it early waits
                page.goto(url, wait_until="commit")
                while not page.evaluate("window.tissueid?.read()?.drawn > 1"):
                    time.sleep(0.01)
                print(f"start to picture, {cache} cache: {time.monotonic() - begun:.2f} s, {load()}")
                if cache == "warm":
                    first, since = page.evaluate("window.tissueid.read().drawn"), time.monotonic()
                    time.sleep(12.0)
                    drawn = page.evaluate("window.tissueid.read().drawn") - first
                    rate = drawn / (time.monotonic() - since)
                    print(f"{rate:.1f} pictures a second, drawn by the processor, {load()}")
                    ages = S_TO_MS * np.array(page.evaluate("window.tissueid.read().ages"))[30:]
                    median, p99 = np.quantile(ages, [0.5, 0.99])
                    print(f"sample to frame, {ages.size} pictures: median {median:.1f} ms, p99 {p99:.1f} ms")
            page.close()
        browser.close()


def main() -> None:
    """Measure and print."""
    if CLIENT in sys.argv:
        if len(sys.argv) == 3:
            sleeper(float(sys.argv[2]))
            return
        url, seconds, hung = sys.argv[2:5]
        one_client(url, float(seconds), hung=bool(int(hung)))
        return
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--pair-seconds", type=float, default=15.0)
    parser.add_argument("--thread", action="store_true")
    parser.add_argument("--start", action="store_true")
    parser.add_argument("--browser", action="store_true")
    asked = parser.parse_args()
    print(f"{load()}, {os.cpu_count()} cores, {Path(sys.executable)}")
    if asked.start:
        start_times()
    if asked.browser:
        picture_age()
    if asked.start or asked.browser:
        return
    if asked.seconds > 0.0:
        words = [sys.executable, __file__, CLIENT, str(asked.seconds)]
        control = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        _, found = session(asked.seconds, 1, thread=asked.thread)
        late = np.quantile(json.loads(control.communicate()[0]), 0.99)
        print(f"a process that only sleeps goes on late by {late:.1f} ms, p99")
        median, p99 = np.quantile(found[0]["ages_ms"], [0.5, 0.99])
        print(
            f"sample age at a client over {asked.seconds:g} s: median {median:.1f} ms, p99 {p99:.1f} ms, "
            f"{found[0]['dropped']} left out, {load()}"
        )
    alone, watched = [], []
    for _ in range(asked.pairs):
        alone.append(session(asked.pair_seconds, 0, thread=asked.thread)[0]["period_us"]["p99"])
        watched.append(session(asked.pair_seconds, 5, hung=1, thread=asked.thread)[0]["period_us"]["p99"])
        print(f"servo p99: {alone[-1]:.0f} us alone, {watched[-1]:.0f} us with five clients, {load()}")
    if alone:
        middle = [statistics.median(found) for found in (alone, watched)]
        print(f"medians: {middle[0]:.0f} us alone, {middle[1]:.0f} us with five clients")


if __name__ == "__main__":
    main()
