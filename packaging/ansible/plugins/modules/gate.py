"""What a gateway says of itself, and whether that is as wanted: an Ansible module. It changes nothing."""

import json
import subprocess
import time
from pathlib import Path
from typing import Any

from ansible.module_utils.basic import AnsibleModule

DOCUMENTATION = """
module: gate
short_description: wait until a gateway says of itself what is wanted
description:
  - Reads the status that a gateway writes for this machine, or the one that it publishes over MQTT, until all that is
    wanted holds without a gap; fails with what does not hold.
options:
  status_file: {type: path, description: The status file of the gateway on this machine.}
  status_command: {type: list, elements: str, description: A program that prints the status of MQTT instead.}
  digest: {type: str, description: Digest of the configuration in force.}
  as_reviewed: {type: bool, default: false, description: And the reviewed one has the same.}
  version: {type: str, description: Version that runs.}
  restarted: {type: bool, default: false, description: It was started again since C(before).}
  accept_function_check: {type: bool, default: false, description: A function check may have begun.}
  free: {type: bool, default: false, description: No truck is in any bay. Of the status file only.}
  before: {type: dict, description: "C(said) of an earlier look: what was wrong then may be wrong now."}
  accepted_alarms: {type: list, elements: str, default: [], description: Alarms that may be new.}
  within_s: {type: float, default: 0, description: The wanted state must begin within this time. 0 looks once.}
  steady_s: {type: float, default: 0, description: And hold for this time.}
  period_s: {type: float, default: 0.5, description: Between two looks.}
  max_age_s: {type: float, default: 30, description: An older MQTT status counts as none.}
"""
RETURN = """
said: {description: What it says., type: dict, returned: always}
faults: {description: What does not hold., type: list, elements: str, returned: always}
"""

FILE_STALE_S = 5.0  # it is written each second
COMMAND_S = 10.0
BAD = {"failure": "NE 107 failure", "out_of_specification": "NE 107 out of specification"}
CHECK = "a function check has begun: settings of its decision are not as last tried; a technician ends it"
Document = dict[str, Any]


def of_file(found: Document) -> Document:
    """The status file's content."""
    bays = found["bays"]
    return {
        "boot": found["boot"],
        "version": found["version"],
        "in_force": found["in_force"],
        "reviewed": found["reviewed"],
        "phases": {name: bay["phase"] for name, bay in bays.items()},
        "faults": {
            name: [BAD[signal] for signal in bay["ne107"] if signal in BAD]
            + [f"no {sensor} yet" for sensor in ("vision", "range") if bay[sensor] == "waiting"]
            for name, bay in bays.items()
        },
        "checks": [name for name, bay in bays.items() if bay["function_check"] not in ("", "off")],
        "high": dict.fromkeys(found["high"], 1),
    }


def of_mqtt(found: Document) -> Document:
    """The payload of the topic `status`: alarms are counted there, not named."""
    configuration, health = found["gateway"]["configuration"], found["health"]
    active = {bay["bay"]: {name.lower() for name in bay["ne107"]["active"]} for bay in health}
    checks = [bay["bay"] for bay in health if bay["function_check"] != "OFF"]
    return {
        "boot": found["boot"],
        "version": found["version"],
        "in_force": configuration["in_force"] or "",
        "reviewed": configuration["reviewed"] or "",
        "phases": {},
        "faults": {
            bay["bay"]: [text for signal, text in BAD.items() if signal in active[bay["bay"]]]
            + ["a sensor has not begun yet"] * ("function_check" in active[bay["bay"]] and bay["bay"] not in checks)
            + ["alarms are not evaluated yet"] * (bay["alarms"] is None)
            for bay in health
        },
        "checks": checks,
        "high": {bay["bay"]: (bay["alarms"] or {}).get("high", 0) for bay in health},
    }


def read(params: Document) -> tuple[Document | None, str]:
    """What it says; or None, and why it says nothing."""
    try:
        return by_command(params) if params["status_command"] else by_file(Path(params["status_file"]))
    except FileNotFoundError as error:
        return None, f"the gateway does not run: no {error.filename}"
    except (OSError, subprocess.SubprocessError) as error:
        return None, f"no status: {error}"
    except (LookupError, TypeError, ValueError) as error:
        return None, f"not a status of this version: {error!r}"


def by_file(path: Path) -> tuple[Document | None, str]:
    found = json.loads(path.read_bytes())
    age_s = (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - found["t_ns"]) / 1e9
    if not -1 <= age_s <= FILE_STALE_S:
        return None, f"the gateway does not run: its status is {age_s:.0f} s old"
    return of_file(found), ""


def by_command(params: Document) -> tuple[Document | None, str]:
    command = params["status_command"]
    done = subprocess.run(command, capture_output=True, timeout=COMMAND_S, check=False, stdin=subprocess.DEVNULL)
    if done.returncode or not done.stdout.strip():
        return None, f"no status over MQTT: {done.stderr.decode(errors='replace').strip() or done.returncode}"
    found = json.loads(done.stdout.splitlines()[-1])
    if found["status"] != "online":
        return None, f"the gateway is {found['status']}: {found['cause']}"
    age_s = time.time() - found["timestamp_ms"] / 1e3
    if abs(age_s) > params["max_age_s"]:
        return None, f"the gateway is silent: its status is {age_s:.0f} s old"
    return of_mqtt(found), ""


def faults(said: Document | None, why: str, params: Document) -> list[str]:
    """What of `params` does not hold."""
    if said is None:
        return [why]
    before = params["before"] or {}
    found = []
    if params["restarted"] and said["boot"] == before.get("boot"):
        found.append("it was not started again")
    if params["digest"] and said["in_force"] != params["digest"]:
        found.append(f"the configuration in force is {said['in_force'][:12]}, wanted {params['digest'][:12]}")
    if params["as_reviewed"] and said["reviewed"] != said["in_force"]:
        found.append(f"the reviewed configuration is {said['reviewed'][:12] or 'not stated'}")
    if params["version"] and said["version"] != params["version"]:
        found.append(f"version {said['version']}, wanted {params['version']}")
    if params["free"]:
        found += [f"{bay}: not empty ({phase})" for bay, phase in said["phases"].items() if phase != "empty"]
    for bay, bad in said["faults"].items():
        was = before.get("faults", {}).get(bay, ())
        found += [f"{bay}: {text}" for text in bad if text not in was]
    if before and not params["accept_function_check"]:  # a bay begins its very first start with one
        found += [f"{bay}: {CHECK}" for bay in said["checks"] if bay not in before["checks"]]
    for alarm, count in said["high"].items():
        if count > before.get("high", {}).get(alarm, 0) and alarm not in params["accepted_alarms"]:
            found.append(f"{alarm}: new alarm of high priority")
    return found


def main() -> None:
    number = {"type": "float", "default": 0.0}
    module = AnsibleModule(
        argument_spec={
            "status_file": {"type": "path"},
            "status_command": {"type": "list", "elements": "str"},
            "digest": {"type": "str"},
            "as_reviewed": {"type": "bool", "default": False},
            "version": {"type": "str"},
            "restarted": {"type": "bool", "default": False},
            "accept_function_check": {"type": "bool", "default": False},
            "free": {"type": "bool", "default": False},
            "before": {"type": "dict"},
            "accepted_alarms": {"type": "list", "elements": "str", "default": []},
            "within_s": number,
            "steady_s": number,
            "period_s": number | {"default": 0.5},
            "max_age_s": number | {"default": 30.0},
        },
        required_one_of=[["status_file", "status_command"]],
        supports_check_mode=True,
    )
    params = module.params
    began_s, since_s = time.monotonic(), None
    while True:
        said, why = read(params)
        found, now_s = faults(said, why, params), time.monotonic()
        since_s = None if found else now_s if since_s is None else since_s
        if since_s is not None and now_s - since_s >= params["steady_s"]:
            module.exit_json(changed=False, said=said, faults=[])
        if since_s is None and now_s - began_s >= params["within_s"]:
            break
        time.sleep(params["period_s"])
    if params["within_s"]:
        module.fail_json(msg="; ".join(found), said=said, faults=found)
    module.exit_json(changed=False, said=said, faults=found)


if __name__ == "__main__":
    main()
