"""Draw the pictures of the live page in `docs/images`, with simulated touches.

`python benchmarks/live_pictures.py [FOLDER]`; needs the extras `web` and `test` and
Debian's chromium. Six household objects are taught 24 touches each; one of them is then
touched until there is a decision. `python
benchmarks/live_pictures.py --report [FOLDER]` runs `palpate demo` and draws the first
part of its report.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from palpate.sensors import open_sensor
from palpate.web import LiveSession, PageServer, create_app

TAUGHT = ("mug", "stapler", "pen", "toothbrush", "box", "ball")
TOUCHED, N_TAUGHT, LONGEST = "mug", 24, 30
SIZES = {"desktop": (1280, 1000), "phone": (390, 1400)}


def taught(session: LiveSession) -> None:
    """Teach and learn, then touch one thing."""
    for name in TAUGHT:
        session.place(None)
        session.teach(name, N_TAUGHT)
        session.place(name)
        while session.teacher.lesson is not None:
            time.sleep(0.1)
    session.place(None)
    session.learn(wait=True)
    session.begin_episode()
    session.place(TOUCHED)
    while session.episode.decision is None and len(session.episode.touches) < LONGEST:
        time.sleep(0.02)
    session.place(None)
    if session.episode.decision != TOUCHED:
        raise SystemExit(f"It must be the {TOUCHED}, got {session.episode.sentence}.")


def pictured(page: Page, address: str, folder: Path, name: str) -> None:
    """Save one picture of the page."""
    page.goto(address)
    page.wait_for_selector("#strip img")
    page.wait_for_timeout(7000)  # until the messages are gone
    page.screenshot(path=folder / f"live-{name}.png")


def report(folder: Path) -> None:
    """Run the demo, and draw the first part of its report."""
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        words = ["-m", "palpate", "demo", "--output", place]
        subprocess.run([sys.executable, *words], check=True)
        (written,) = Path(place).rglob("*.html")
        browser = driver.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1080, "height": 950})
        page.goto(written.as_uri())
        page.screenshot(path=folder / "report.png")
        browser.close()


def main() -> None:
    """Draw both pictures, or that of the report."""
    words = [word for word in sys.argv[1:] if word != "--report"]
    folder = Path(words[0] if words else "docs/images")
    if "--report" in sys.argv:
        report(folder)
        return
    sensor = open_sensor("sim:mug", rate_hz=40.0, hold=2, gap=3)
    with (
        tempfile.TemporaryDirectory() as place,
        LiveSession(sensor, library=Path(place) / "desk", error=0.05) as session,
        sync_playwright() as driver,
    ):
        taught(session)
        server = PageServer()
        token = server.token
        browser = driver.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )
        with server.running(create_app(session, token)) as address:
            for name, (width, height) in SIZES.items():
                page = browser.new_page(viewport={"width": width, "height": height})
                pictured(page, f"{address}?token={token}", folder, name)
            browser.close()


if __name__ == "__main__":
    main()
