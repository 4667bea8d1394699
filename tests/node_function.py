"""Runs the code of a Node-RED function node in Node.js, with a context, a node and a clock of its own."""

import json
import subprocess
from typing import Any

HARNESS = """
const steps = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const code = steps.code;
let clock = 1000000, stored = {};
const context = { get: key => stored[key], set: (key, value) => { stored[key] = JSON.parse(JSON.stringify(value)); } };
const statuses = [];
const node = { status: status => statuses.push(status.text) };
const FakeDate = { now: () => clock };
const judge = new Function('msg', 'context', 'node', 'Date', code);
const out = [];
for (const [ms, msg] of steps.messages) {
    clock += ms;
    out.push([judge(msg, context, node, FakeDate), statuses.at(-1)]);
}
console.log(JSON.stringify(out));
"""


def run_function(code: str, messages: list[tuple[int, Any]]) -> list[Any]:
    """[(ms later, a message | words | "tick" | "")] -> [[the node's outputs, its status text]]."""
    made = [
        (
            ms,
            sent
            if isinstance(sent, dict)
            else {"topic": "tick", "payload": 0}
            if sent == "tick"
            else {"topic": "poll", "payload": sent},
        )
        for ms, sent in messages
    ]
    done = subprocess.run(
        ["node", "-e", HARNESS],
        input=json.dumps({"code": code, "messages": made}),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout))
