"""Decodes payloads (a JSON list of base64 texts on stdin) with PyPI's pysparkplug; prints what it reads as JSON.

A program of its own: its code and the tests' own schema would register the same names in one process.
"""

import base64
import datetime
import json
import sys

import pysparkplug


def _plain(value: object) -> object:
    return {"long": str(round(value.timestamp() * 1000))} if isinstance(value, datetime.datetime) else value


read = []
for text in json.load(sys.stdin):
    payload = pysparkplug.DBirth.decode(base64.b64decode(text))
    read.append([[m.name, m.datatype.name, _plain(m.value), m.timestamp, m.is_historical] for m in payload.metrics])
json.dump(read, sys.stdout)
