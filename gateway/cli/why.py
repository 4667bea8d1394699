"""Why were the outputs as they were at some moment? Answered from the recording, months later, too.

TIME is local, of the newest day on which it was recorded, unless a date is given; with a zone it is of that zone:
  03:12    03:12:05    2026-11-23 03:12    2026-11-23T03:12:05+01:00

examples:
  gateway why 03:12                                       of the one bay recorded here
  gateway why 03:12 --bay bay2 --html why.html            a page to send: pictures, plots, every cause
  gateway why "2026-11-23 03:12" --records /media/usb/bay1
  gateway why 03:12:05 --config config/gateway.toml --json
"""

import argparse
import json
from pathlib import Path

from gateway.cli import recording_args, vision_args
from gateway.durations import NS_PER_S
from gateway.records import account, moment, page
from gateway.records.chain import Link
from gateway.records.inquiry import Answer, Inquiry
from gateway.records.moment import clock, shown
from gateway.records.picture_search import pictures_near
from gateway.records.segment import RecordedPicture
from gateway.vision.offline.reports.page import write

MOST_LINKS = 16  # shown on a terminal before the moment, and behind it


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("time", nargs="+", metavar="TIME", help="03:12, 03:12:05, 2026-11-23 03:12, ISO with a zone")
    recording_args.configure(parser)
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a report in one file, with pictures and plots")
    parser.add_argument("--json", action="store_true", help="one JSON object, for programs")


def main(args: argparse.Namespace) -> int:
    """0: answered; 1: nothing was decided at that moment. Raises ConfigError."""

    asked = moment.parsed(" ".join(args.time))
    folder = recording_args.folder(args)
    inquiry = Inquiry(folder)
    first_ns, last_ns = inquiry.span()
    at_ns = moment.resolved(asked, first_ns, last_ns)
    answer = inquiry.at(at_ns, at_ns + round(asked.length_s * NS_PER_S))
    pictures = list(pictures_near(folder, answer.begin_ns, answer.end_ns))
    if args.html is not None:
        write(args.html, page.html(answer, pictures, vision_args.made_now()))
    if args.json:
        print(json.dumps(account.as_json(answer, pictures), allow_nan=False, default=str))
    else:
        _print(answer, pictures)
        if args.html is not None:
            print(f"report: {args.html}")
    return int(bool(answer.silence))


def _print(answer: Answer, pictures: list[RecordedPicture]) -> None:

    head = answer.head
    print(f"{head.bay}, {shown(answer.at_ns)} ({head.site}.{head.instance}, gateway {head.gateway_version})")
    print(account.headline(answer))
    for text in account.warnings(answer):
        print(f"! {text}")
    if answer.state is not None:
        row = dict(account.outputs(answer.state))
        print(f"\n  stop {row['stop']}, may_move {row['may_move']}, in_place {row['in_place']}, moved {row['moved']}")
        print(f"  reason {row['reason']}")
        if answer.since_ns is not None:
            lasted_s = (answer.at_ns - answer.since_ns) / NS_PER_S
            print(f"  stop and may_move have been so since {shown(answer.since_ns)}, {lasted_s:.1f} s before")
    _section("besides", [("", cause.text) for cause in answer.causes[1:]])
    _section("how it came about", _links(answer.chain[-MOST_LINKS:]))
    _section("and then", _links(answer.after[:MOST_LINKS]))
    if answer.state is not None:
        _section("state", account.sensors(answer, answer.state))
    _section("who did what", [(clock(t), text) for t, text in account.done_by(answer)[-MOST_LINKS:]])
    _section("events", [(clock(t), text) for t, text in account.happened(answer)][-MOST_LINKS:])
    _section("configuration", account.settings(answer))
    if pictures:
        begin, end = clock(pictures[0].head.unix_ns), clock(pictures[-1].head.unix_ns)
        print(f"\npictures: {len(pictures)}, {begin} to {end}; --html FILE shows them")


def _links(links: tuple[Link, ...]) -> list[tuple[str, str]]:

    return [
        (clock(link.unix_ns), f"  {link.why}" if not link.what else f"{link.what}: {_by(link)}{link.why}")
        for link in links
    ]


def _by(link: Link) -> str:
    return f"[{link.by}] " if link.by else ""


def _section(title: str, rows: list[tuple[str, str]]) -> None:
    if not rows:
        return
    print(f"\n{title}")
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        print(f"  {name:<{width}}  {text}" if width else f"  {text}")
