"""The explorer in a real browser: JupyterLab under headless Chromium, a slider moved by its keys.

python benchmarks/explorer.py                 writes benchmarks/explorer.json
python benchmarks/explorer.py --steps 3 --picture explorer.png --results explorer.json

Needs `pip install ".[browser,notebook]"` and Chromium or Chrome. The kernel is kept to one core.
Measured in the browser is the time from the key to the new picture on the page, and in the kernel
the time from the new number to the new picture.
"""

import argparse
import itertools
import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, TimeoutError, sync_playwright

CODE = (
    "import vibrojax as vj\nvj.explore(vj.default_rig, gap=vj.Range(0.1e-3, 1e-3), "
    "stiffness=vj.Range(500, 50000))"
)
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PAUSE = 100
"""Milliseconds from one picture to the next key, about as fast as a hand moves on."""
PICTURE = ".jp-OutputArea img.widget-image"
STARTED = "!/\\[ \\]/.test(document.querySelector('.jp-InputPrompt').innerText)"
WATCH = """() => {
  const picture = document.querySelector('.jp-OutputArea img.widget-image');
  if (!window.loads) {
    picture.addEventListener('load', () => window.loads.push(performance.now()));
    document.addEventListener('keydown', () => window.keys.push(performance.now()), true);
  }
  window.loads = []; window.keys = [];
}"""


def notebook() -> dict:
    cell = {
        "cell_type": "code",
        "id": "explore",
        "metadata": {},
        "outputs": [],
        "execution_count": None,
        "source": CODE,
    }
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": [cell], "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


class Lab:
    """JupyterLab on a free port, its settings in a folder of its own, on one core."""

    def __init__(self, folder: Path, core: int | None):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"http://127.0.0.1:{free.getsockname()[1]}"
        own = {
            name: str(folder / name)
            for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")
        }
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "jupyterlab",
                "--no-browser",
                "--allow-root",
                f"--port={self.address.rsplit(':', 1)[1]}",
                "--ServerApp.token=",
                "--ServerApp.password=",
                f"--ServerApp.root_dir={folder}",
                "--LabApp.news_url=None",
            ],
            env=os.environ | own | {"IPYTHONDIR": str(folder / "ipython")},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        if core is not None and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(self.process.pid, {core})

    def __enter__(self) -> "Lab":
        for _ in range(240):
            try:
                urllib.request.urlopen(f"{self.address}/api")
                return self
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.25)
        raise RuntimeError("JupyterLab did not start within a minute.")

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.wait(30)


def open_explorer(page: Page, address: str) -> float:
    """Run the cell; seconds until its picture is there."""
    page.goto(f"{address}/lab/tree/explore.ipynb?reset")
    page.wait_for_selector(".jp-Notebook .jp-CodeCell", timeout=120_000)
    page.wait_for_timeout(3000)  # keys pressed before the page is ready are lost
    begun = time.perf_counter()
    for _ in range(5):
        page.click(".jp-CodeCell .jp-InputArea-editor")
        page.keyboard.press("Shift+Enter")
        try:
            page.wait_for_function(STARTED, timeout=5000)
            break
        except TimeoutError:
            continue
    page.wait_for_selector(PICTURE, timeout=400_000)
    page.wait_for_function(f"document.querySelector('{PICTURE}').naturalWidth > 0")
    return time.perf_counter() - begun


def words(page: Page) -> str:
    return page.inner_text(".widget-html-content >> nth=-1")


def move(page: Page, slider: int, steps: int) -> dict:
    """Move a slider by its right arrow key; what the browser and the kernel say of the time."""
    page.wait_for_timeout(1500)
    page.evaluate(WATCH)
    page.locator(".noUi-handle").nth(slider).focus()
    sources, kernel = [page.get_attribute(PICTURE, "src")], []
    for _ in range(steps):
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"window.loads.length > {len(kernel)}", timeout=20_000)
        page.wait_for_timeout(PAUSE)  # the words come after the picture
        sources.append(page.get_attribute(PICTURE, "src"))
        kernel.append(float(re.search(r"Drawn in (\d+) ms", words(page)).group(1)))
    keys, loads = page.evaluate("() => [window.keys, window.loads]")
    key_to_picture = [min((t - key for t in loads if t > key), default=np.nan) for key in keys]
    return {
        "changed": sum(a != b for a, b in itertools.pairwise(sources)),
        "key_to_picture_ms": [round(float(t), 1) for t in key_to_picture],
        "kernel_ms": kernel,
    }


def hover(page: Page) -> bool:
    """Move the mouse over the curve; whether the orbit followed."""
    before, box = words(page), page.locator(PICTURE).bounding_box()
    for across in (0.30, 0.25):
        page.mouse.move(box["x"] + across * box["width"], box["y"] + 0.7 * box["height"])
        page.wait_for_timeout(800)
    return words(page) != before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--picture", type=Path, help="where to put a picture of the page")
    here = Path(__file__).parent
    parser.add_argument("--results", type=Path, default=here / "explorer.json")
    chosen = parser.parse_args()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    core = max(cores, default=None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "explore.ipynb").write_text(json.dumps(notebook()))
        with Lab(folder, core) as lab:
            if len(cores) > 1:  # the browser gets the other cores
                os.sched_setaffinity(0, cores - {core})
            results = measure(lab.address, chosen.steps, chosen.picture)
    chosen.results.write_text(json.dumps(results, indent=1) + "\n")
    print(json.dumps(results, indent=1))


def measure(address: str, steps: int, picture: Path | None) -> dict:
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=browser_path, args=FLAGS)
        page = browser.new_page(viewport={"width": 1500, "height": 900})
        first = open_explorer(page, address)
        page.wait_for_timeout(2000)
        gap, stiffness = move(page, 0, steps), move(page, 1, steps)
        followed = hover(page)
        if picture:
            page.screenshot(path=picture)
        version = browser.version
        browser.close()
    return {
        "first_picture_s": round(first, 1),
        "gap": gap,
        "stiffness": stiffness,
        "orbit_follows_mouse": followed,
        "median_key_to_picture_ms": float(np.median(gap["key_to_picture_ms"])),
        "median_kernel_ms": float(np.median(gap["kernel_ms"])),
        "chromium": version,
        "python": platform.python_version(),
    }


if __name__ == "__main__":
    main()
