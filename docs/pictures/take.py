"""Take the pictures of the documentation anew: the replay in the native viewer, the report in a browser.

Needs Mesa's Vulkan driver and chromium, which on Debian are the packages mesa-vulkan-drivers and chromium. No screen is
needed: the viewer and the browser draw unseen.

    python docs/pictures/take.py --demo out --recorded TAKE.csv

`--demo` takes a demo that was made already instead of making one. TAKE.csv is any tracker recording; its picture shows
a recorded operator instead of the simulated one. Each picture stays under 300 kB; the sheet of printed pages needs
pdftoppm (poppler-utils).
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from cyclekit.dataset.dataset import Dataset
from cyclekit.learning.networks.saved import load_model
from cyclekit.replay import write_replay
from cyclekit.replay.viewer import viewer_program

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "support"))
from browser import Tab, open_browser  # noqa: E402

PORT = 9977
MENU_PX = 37
LARGEST = 300_000

TOGETHER = """
[[sequence]]
name = "sorting last"
places = ["home", "feeder", "fixture", "feeder", "fixture", "feeder", "fixture",
          "tray", "rack_1", "tray", "rack_2", "tray", "rack_3", "tray", "rack_4", "home"]
operator = ["rest", "shelf", "bench", "fixture", "bench", "fixture", "bench", "fixture",
            "label", "pack", "scan", "rest"]
"""


def demo(out: Path, *options: str) -> None:
    """Run the demo, quietly."""
    subprocess.run([sys.executable, "-m", "cyclekit", "demo", "--quiet", "--out", str(out), *options], check=True)


def save(png: bytes, picture: Path, *, top_px: int = 0, height_px: int | None = None) -> None:
    """Save a picture in 256 colours, from `top_px` on, `height_px` high."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    bottom = image.height if height_px is None else min(image.height, top_px + height_px)
    image = image.crop((0, top_px, image.width, bottom)).quantize(256, dither=Image.Dither.NONE)
    image.save(picture, optimize=True)
    size = picture.stat().st_size
    print(f"{picture.name}: {image.width} x {image.height}, {size / 1000:.0f} kB")  # noqa: T201
    if size > LARGEST:
        raise SystemExit(f"{picture}: larger than {LARGEST / 1000:.0f} kB")


def replay_picture(recording: Path, picture: Path, *, timeline: str, at: float, size: str = "1400x800") -> None:
    """Open a replay in the native viewer, stop it at `at` (seconds, or path phase) and save what it shows."""
    address = ["--port", str(PORT), "--bind", "127.0.0.1", "--hide-welcome-screen", "--headless"]
    command = [*viewer_program(), str(recording), "--window-size", size, *address]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        client = _connect()
        time.sleep(12.0)  # the viewer's first messages cover the plots for some seconds
        if timeline == "path_phase":
            client.set_time(timeline, sequence=round(at), play_state="paused")
        else:
            client.set_time(timeline, duration=at, play_state="paused")
        time.sleep(4.0)
        with tempfile.TemporaryDirectory() as folder:
            shot = Path(folder) / "shot.png"
            client.save_screenshot(str(shot))
            save(shot.read_bytes(), picture, top_px=MENU_PX)
    finally:
        viewer.terminate()
        viewer.wait()


def _connect() -> ViewerClient:
    for _ in range(60):
        time.sleep(0.5)
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{PORT}/proxy")
            if client.get_state().active_recording:
                return client
        except Exception as error:
            last = error
    raise SystemExit(f"the viewer does not answer: {last}")


def play_picture(tab: Tab, page: Path) -> bytes:
    """Return the part to play with, after three visits and a threshold were moved."""
    tab.show(page, width=1180, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for row in (5, 4, 3):
        tab.ask(f"document.querySelectorAll('#play li')[{row}].querySelector('button').click()")
    tab.ask(
        "(s => { s.value = '-0.2'; s.dispatchEvent(new Event('input')); })(document.querySelector('#play-slider-0'))"
    )
    tab.ask("document.activeElement.blur(); document.getElementById('play').scrollIntoView()")
    return tab.picture()


def together(out: Path) -> Path:
    """Return a report of a simulated cell in which robot and operator wait for each other."""
    (out / "together.toml").write_text(TOGETHER, encoding="utf-8")
    page, given = out / "together.html", ["--sequences", str(out / "together.toml"), "--takt", "58s"]
    for words in (
        ["simulate", "shared-fixture", "--executions", "40", "--out", str(out / "logs")],
        ["ingest", str(out / "logs"), "--out", str(out / "both")],
        ["train", str(out / "both"), "--out", str(out / "model")],
        ["report", str(out / "both"), "--model", str(out / "model"), *given, "--out", str(page)],
    ):
        subprocess.run([sys.executable, "-m", "cyclekit", *words, "--quiet"], check=True)
    return page


def together_picture(tab: Tab, page: Path) -> bytes:
    """Return the part to play with of both agents, after one wait was removed and a task of each was moved."""
    tab.show(page, width=1180, height=1640)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for agent in (0, 1):
        tab.ask(f"document.querySelectorAll('#play ol')[{agent}].querySelectorAll('li button')[7].click()")
    tab.ask("document.querySelector('.play-switch input').click()")
    tab.ask("document.activeElement.blur(); document.getElementById('play').scrollIntoView()")
    time.sleep(3.0)  # all cycles are walked
    return tab.picture()


def page_pictures(tab: Tab, page: Path, printed: Path) -> None:
    """Save the page as on a desk, on a phone and printed."""
    tab.show(page, width=1180, height=980)
    save(tab.picture(), HERE / "report.png")
    for section in ("where", "why", "helps"):
        top = tab.ask(f"document.getElementById('{section}').getBoundingClientRect().top + scrollY")
        tab.ask(f"scrollTo(0, {top})")
        tab.call("Emulation.setDeviceMetricsOverride", width=1180, height=1600, deviceScaleFactor=1, mobile=False)
        time.sleep(0.5)
        save(tab.picture(), HERE / f"report-{section}.png")
    save(play_picture(tab, page), HERE / "report-play.png")
    tab.show(page, width=390, height=844, phone=True, scale=1.5)
    save(tab.picture(), HERE / "report-phone.png")
    sheets = subprocess.run(["pdftoppm", "-r", "45", "-png", str(page.with_suffix(".pdf")), str(printed)], check=False)
    if sheets.returncode == 0:
        pages = [Image.open(file) for file in sorted(printed.parent.glob(f"{printed.name}-*.png"))]
        width, height = pages[0].size
        columns = 6
        sheet = Image.new("RGB", (columns * (width + 8), -(-len(pages) // columns) * (height + 8)), "#9aa5b1")
        for number, each in enumerate(pages):
            sheet.paste(each, ((number % columns) * (width + 8) + 4, number // columns * (height + 8) + 4))
        whole = io.BytesIO()
        sheet.save(whole, "PNG")
        save(whole.getvalue(), HERE / "report-print.png")


def replays(made: Path, out: Path, at: float, phase: float) -> None:
    """Save one execution at the second `at`, and two side by side at `phase`."""
    dataset, model = Dataset.open(made / "dataset"), load_model(made / "model")
    one = write_replay(dataset, "1", out / "one.rrd", model=model)
    two = write_replay(dataset, ["1", "3"], out / "two.rrd", model=model)
    replay_picture(one.path, HERE / "replay.png", timeline="execution", at=at)
    replay_picture(two.path, HERE / "replay-two.png", timeline="path_phase", at=phase)


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(description="Take the pictures of the documentation anew.")
    parser.add_argument("--demo", type=Path, help="a demo that was made already")
    parser.add_argument("--recorded", type=Path, help="a tracker recording that walks in the operator's place")
    parser.add_argument("--at", type=float, default=61.5, help="second of the execution that the replays show")
    parser.add_argument("--phase", type=float, default=1550, help="path phase of the replay side by side")
    parser.add_argument("--page-only", action="store_true", help="leave the replays as they are")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        made = asked.demo or out / "demo"
        if asked.demo is None:
            demo(made)
        if not asked.page_only:
            replays(made, out, asked.at, asked.phase)
        options = ["--model", str(made / "model"), "--sequences", str(made / "sequences.toml"), "--takt", "100s", "-q"]
        options += ["--what-if", str(made / "changes.toml"), "--plan", str(made / "jobs.toml")]
        report = [sys.executable, "-m", "cyclekit", "report", str(made / "dataset"), *options]
        subprocess.run([*report, "--out", str(out / "r.html"), "--pdf", str(out / "r.pdf")], check=True)
        with open_browser() as tab:
            page_pictures(tab, out / "r.html", out / "sheet")
            save(together_picture(tab, together(out)), HERE / "report-play-both.png")
        if asked.recorded:
            demo(out / "recorded", "--operator-log", str(asked.recorded))
            recorded = out / "recorded" / "replay.rrd"
            replay_picture(recorded, HERE / "replay-recorded-operator.png", timeline="execution", at=19.0)


if __name__ == "__main__":
    main()
