"""Take the pictures of the documentation anew: the replay in the native viewer, the report in a browser.

Needs a screen (or xvfb), Mesa's Vulkan driver and chromium, which on Debian are the packages xvfb, mesa-vulkan-drivers
and chromium:

    xvfb-run -a -s "-screen 0 1500x900x24" python docs/pictures/take.py --recorded TAKE.csv

TAKE.csv is any tracker recording; its picture shows a recorded operator instead of the simulated one.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rerun.experimental import ViewerClient

HERE = Path(__file__).parent
PORT = 9977
CHROMIUM = ("chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking")


def demo(out: Path, *options: str) -> None:
    """Run the demo, quietly."""
    subprocess.run([sys.executable, "-m", "cyclekit", "demo", "--quiet", "--out", str(out), *options], check=True)


def replay_picture(recording: Path, picture: Path, *, at_s: float, size: str = "1400x800") -> None:
    """Open a replay in the native viewer, stop it at `at_s` seconds of the execution and save what it shows."""
    address = ["--port", str(PORT), "--bind", "127.0.0.1", "--hide-welcome-screen"]
    command = [sys.executable, "-m", "rerun", str(recording), "--window-size", size, *address]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        client = _connect()
        time.sleep(15.0)  # the viewer's first messages cover the plots for some seconds
        client.set_time("execution", duration=at_s, play_state="paused")
        time.sleep(3.0)
        client.save_screenshot(str(picture.resolve()))
        time.sleep(1.0)
    finally:
        viewer.terminate()
        viewer.wait()


def _connect() -> ViewerClient:
    for _ in range(60):
        time.sleep(0.5)
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{PORT}/proxy")
            client.get_state()
        except Exception as error:
            last = error
        else:
            return client
    raise SystemExit(f"the viewer does not answer: {last}")


def page_picture(page: Path, picture: Path, *, size: str = "1180,980") -> None:
    """Save the top of a page as a headless browser shows it."""
    shot = [f"--screenshot={picture.resolve()}", f"--window-size={size}", page.resolve().as_uri()]
    subprocess.run([*CHROMIUM, *shot], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(description="Take the pictures of the documentation anew.")
    parser.add_argument("--recorded", type=Path, help="a tracker recording that walks in the operator's place")
    parser.add_argument("--at", type=float, default=19.0, help="second of the execution that the replays show")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        demo(out / "demo")
        replay_picture(out / "demo" / "replay.rrd", HERE / "replay.png", at_s=asked.at)
        page_picture(out / "demo" / "report.html", HERE / "report.png")
        if asked.recorded:
            demo(out / "recorded", "--operator-log", str(asked.recorded))
            recorded = out / "recorded" / "replay.rrd"
            replay_picture(recorded, HERE / "replay-recorded-operator.png", at_s=asked.at)


if __name__ == "__main__":
    main()
