"""From the event that a truck in place rolls until each page shows its alarm: milliseconds, in Chromium, one gateway.

    python -m bench.alarm_pages --rolls 10

All pages are open side by side in one browser. The truck of tests/browser/test_visit.py creeps again and again; the
ranger alone shows it (method "paper"). The driver's display: until the word BRAKE.
"""

import argparse
import json
import re
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from urllib.request import urlopen

from tests.browser.chromium import chromium, visited
from tests.browser.plant import plant
from tests.browser.test_visit import CREEPING, PAGES

DRIVER = "/driver/bay1?lang=en"
# Unix times, ms, at which the first text appeared in the page, after it was not there.
WATCH = """
window.__shown = [];
let was = false;
const look = () => {
  const bar = document.querySelector('.alarmbar')?.textContent ?? '';
  const is = document.querySelector('#word')?.textContent === 'BRAKE'
    || (bar.includes('Truck rolls') && bar.includes('active, not acknowledged'));
  if (is && !was) window.__shown.push(Date.now());
  was = is;
};
addEventListener('DOMContentLoaded', () => new MutationObserver(look).observe(document.documentElement,
  { subtree: true, childList: true, characterData: true }));
"""
CYCLE_S = 14.0
LATEST_MS = 5_000


def rolled_ms(url: str) -> list[int]:
    """Unix times, ms, of each time that it began to roll nearer."""
    with urlopen(f"{url}/api/events") as answer:
        events = [row["event"] for row in json.load(answer)["events"]]
    rolls = [(event, re.search(r"Z (\d+) mm.*-> Z (\d+) mm", event["detail"])) for event in events]
    return [event["timestamp_ms"] for event, z in rolls if event["kind"] == "rolling" and z and int(z[2]) < int(z[1])]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rolls", type=int, default=10, help="default %(default)s")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as kept:
        running = kept.enter_context(plant(Path(folder), CREEPING))
        browser = kept.enter_context(chromium())
        pages = {
            path: kept.enter_context(visited(browser, running.url + path, before=WATCH))[0] for path in (*PAGES, DRIVER)
        }
        open_ms = time.time() * 1000
        for _ in range(args.rolls):
            pages[DRIVER].wait_for_timeout(1000 * CYCLE_S)
        rolls = [roll for roll in rolled_ms(running.url) if roll > open_ms]
        print(f"{'page':24} shown  median ms  longest ms")
        for path, page in pages.items():
            shown = page.evaluate("() => window.__shown")
            waits = [min((at - roll for at in shown if at >= roll), default=LATEST_MS) for roll in rolls]
            seen = [wait for wait in waits if wait < LATEST_MS]
            number = f"{len(seen)} of {len(waits)}"
            print(f"{path:22} {number:>8} {median(seen):10.0f} {max(seen):11}" if seen else f"{path:22} {number:>8}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
