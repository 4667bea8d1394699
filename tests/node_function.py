"""Runs the code of a Node-RED function node in Node.js, with a context, a node and a clock of its own."""

import json
import subprocess
from typing import Any

HARNESS = """
const { code, runs } = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const out = runs.map(messages => {
    let clock = 1000000, stored = {};
    const set = (key, value) => { stored[key] = JSON.parse(JSON.stringify(value)); };
    const context = { get: key => stored[key], set };
    const statuses = [];
    const node = { status: status => statuses.push(status.text) };
    const FakeDate = { now: () => clock };
    const judge = new Function('msg', 'context', 'node', 'Date', code);
    return messages.map(([ms, msg]) => {
        clock += ms;
        return [judge(msg, context, node, FakeDate), statuses.at(-1)];
    });
});
console.log(JSON.stringify(out));
"""
Messages = list[tuple[int, Any]]


def run_function(code: str, messages: Messages) -> list[Any]:
    """[(ms later, a message | words | "tick" | "")] -> [[the node's outputs, its status text]]."""
    return run_each(code, [messages])[0]


def run_each(code: str, runs: list[Messages]) -> list[list[Any]]:
    """As `run_function`, each run from the beginning."""
    done = subprocess.run(
        ["node", "-e", HARNESS],
        input=json.dumps({"code": code, "runs": [[(ms, _message(sent)) for ms, sent in run] for run in runs]}),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout))


def _message(sent: Any) -> Any:
    if isinstance(sent, dict):
        return sent
    return {"topic": "tick", "payload": 0} if sent == "tick" else {"topic": "poll", "payload": sent}
