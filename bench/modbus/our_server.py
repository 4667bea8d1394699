"""The gateway's Modbus server with one bay whose control task ticks, for the benches: prints its port first.

    python bench/modbus/our_server.py {asyncio,uvloop} [--churn] [--set KEY=VALUE ...]

`--churn`: instead of the bay's image, one that is another at every request, all of its words the same number: a torn
answer shows. `--set`: keys of [modbus], as JSON.
"""

import argparse
import asyncio
import json
import resource
import sys

from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import BayConfig, ModbusConfig
from gateway.hub import Hub
from gateway.modbus.protocol.answers import ReadImage, Unit
from gateway.modbus.registers.bay_unit import image_of
from gateway.modbus.registers.register_map import BLOCK_WORDS
from gateway.modbus.server.server import ModbusServer


def churning() -> ReadImage:
    at = 0

    def image() -> tuple[int, ...]:
        nonlocal at
        at = at + 1 & 0xFFFF
        return (at,) * BLOCK_WORDS

    return image


async def main(args: argparse.Namespace) -> None:
    clock = SystemClock()
    bay = BayControl(BayConfig(), Hub(["bay1"]), clock)
    read = churning() if args.churn else image_of(bay.state, "big", clock)
    keys = {"connections_per_address": 4096} | dict(args.set)  # all of a bench's clients have one address
    config = ModbusConfig(port=0, **keys)
    async with ModbusServer(config, {1: Unit(read)}) as server, asyncio.TaskGroup() as group:
        group.create_task(bay.run())
        print(server.port, flush=True)
        loop = asyncio.get_running_loop()
        while await loop.run_in_executor(None, sys.stdin.readline):  # each line asks for the counters
            told = {
                "open": server.stats.open,
                "connections": server.stats.connections,
                "requests": server.stats.requests,
                "refused": {why.name: count for why, count in server.stats.refused.items()},
                "peak_kib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            }
            print(json.dumps(told), flush=True)
        raise SystemExit


def setting(text: str) -> tuple[str, object]:
    key, _, value = text.partition("=")
    return key, json.loads(value)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("loop", choices=["asyncio", "uvloop"])
    parser.add_argument("--churn", action="store_true")
    parser.add_argument("--set", type=setting, nargs="*", default=[])
    args = parser.parse_args()
    if args.loop == "uvloop":
        import uvloop

        uvloop.run(main(args))
    else:
        asyncio.run(main(args))
