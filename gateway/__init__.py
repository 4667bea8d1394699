"""PLC integration gateway: reports to a loading-control PLC when a truck's filling port is under the loading spout."""


def __getattr__(name: str) -> str:
    """`gateway.__version__`, read on first use: child processes never use it, and start 30 ms sooner."""
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415

        return version("plc-loading-gateway")
    raise AttributeError(name)
