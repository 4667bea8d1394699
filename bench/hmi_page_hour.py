"""Does a page that stays open grow? Memory and processor time of one page, minute by minute.

    python -m bench.hmi_page_hour [--minutes 60] [--scenario day] [--page /#bay1]

One `gateway simulate`, and one page of it in a real browser (Debian's chromium-headless-shell). Each minute the page's
garbage is collected; told are the bytes that are left of its scripts' memory, its nodes and listeners, the processor
time of its main thread, and the memory of the web process. At the end: what a straight line through the second half
grows an hour.
"""

import argparse
import json
import statistics
import subprocess
import sys
import threading
import time

import psutil
from playwright.sync_api import Browser

from tests.browser.chromium import chromium

COLUMNS = ("minute", "scripts kB", "nodes", "listeners", "main thread", "web MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--scenario", default="day")
    parser.add_argument("--page", default="/#bay1")
    args = parser.parse_args()
    command = ["simulate", "--scenario", args.scenario, "--modbus-port", "0", "--hmi-port", "0", "--json"]
    with subprocess.Popen([sys.executable, "-m", "gateway", *command], stdout=subprocess.PIPE, text=True) as gateway:
        assert gateway.stdout is not None
        started = json.loads(gateway.stdout.readline())
        threading.Thread(target=gateway.stdout.read, daemon=True).start()
        try:
            with chromium() as browser:
                rows = _watched(browser, started["hmi"].rstrip("/") + args.page, gateway.pid, args.minutes)
        finally:
            gateway.terminate()
    later = rows[-max(2, len(rows) // 2) :]
    for column, name in ((1, "scripts, kB"), (2, "nodes"), (5, "web process, MB")):
        slope = statistics.linear_regression([row[0] for row in later], [row[column] for row in later]).slope
        print(f"{name}: {60 * slope:+.1f} an hour")


def _watched(browser: Browser, url: str, pid: int, minutes: int) -> list[tuple[float, ...]]:
    page = browser.new_page(viewport={"width": 1366, "height": 768})
    page.goto(url)
    devtools = page.context.new_cdp_session(page)
    devtools.send("Performance.enable")
    [web] = [child for child in psutil.Process(pid).children() if child.name() == "gw-hmi"]
    print("".join(f"{name:>13}" for name in COLUMNS), flush=True)
    rows: list[tuple[float, ...]] = []
    begun, busy_s = time.monotonic(), 0.0
    for minute in range(minutes + 1):
        page.wait_for_timeout(max(0.0, 60 * minute - (time.monotonic() - begun)) * 1000 + 1)
        devtools.send("HeapProfiler.collectGarbage")
        found = {row["name"]: row["value"] for row in devtools.send("Performance.getMetrics")["metrics"]}
        share = (found["TaskDuration"] - busy_s) / 60 if minute else 0.0
        busy_s = found["TaskDuration"]
        row = (
            float(minute),
            found["JSHeapUsedSize"] / 1e3,
            found["Nodes"],
            found["JSEventListeners"],
            share,
            web.memory_info().rss / 1e6,
        )
        print(f"{row[0]:13.0f}{row[1]:13.0f}{row[2]:13.0f}{row[3]:13.0f}{row[4]:13.1%}{row[5]:13.1f}", flush=True)
        rows.append(row)
    return rows


if __name__ == "__main__":
    main()
