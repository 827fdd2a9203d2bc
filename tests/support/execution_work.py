"""What the workers of the tests do; they must find it in a module, and it must start fast."""

import errno
import os
import resource
import signal
import sys
import time
from pathlib import Path

from turnwright.errors import GougeError
from turnwright.progress import cores
from turnwright.studies import Case, Store, local, run_cases


def cases(count, **more):
    return [Case(key=f"case-{n}", data={"n": n, **more}) for n in range(count)]


def answer(n):
    return {"n": n, "square": n * n, "third": n / 3, "word": str(n), "none": None}


def begun(log):
    """The numbers and processes of all computations that began, in their order."""
    file = Path(log)
    return [tuple(map(int, line.split())) for line in file.read_text().splitlines()] if file.exists() else []


def plain(data, shared, store):
    if "log" in shared:
        with Path(shared["log"]).open("a") as log:  # one short line at a time is written whole
            log.write(f"{data['n']} {os.getpid()}\n")
    time.sleep(shared.get("seconds", 0))
    return answer(data["n"])


def deadly(data, shared, store):
    row = plain(data, shared, store)
    if data["n"] == shared["killer"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return row


def failing(data, shared, store):
    row = plain(data, shared, store)
    troubles = {
        1: GougeError("the feed 2 mm is too wide for the tool 0.1 mm: use less"),
        2: ZeroDivisionError("float division\nby zero"),
        3: MemoryError("12 GB"),
        4: OSError(errno.ENOSPC, "No space left on device", "/somewhere/map.npy"),
        5: ModuleNotFoundError("No module named 'zarr'"),
    }
    if data["n"] in troubles:
        raise troubles[data["n"]]
    return row | ({"odd": {1, 2}} if data["n"] == 6 else {})


def filling(data, shared, store):
    """From a given case on the system lets this process write no more than a few bytes."""
    row = plain(data, shared, store)
    if data["n"] == shared["full"]:
        sys.dont_write_bytecode = True  # it would be cut, and kept
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, resource.RLIM_INFINITY))
    return row


def numbers(data, shared, store):
    import numpy as np

    heights = store.array(shared["heights"])
    return {"sum": heights[: data["n"] + 1].sum(), "count": np.int64(heights.size), "limit": np.inf}


def threads(data, shared, store):
    time.sleep(0.05)
    return {"cores": cores(), "omp": os.environ.get("OMP_NUM_THREADS"), "pid": os.getpid()}


def writing(data, shared, store):
    for part in range(100):
        store.put_row(f"big-{data['n']}-{part}", {"text": "x" * 100_000, "length": 100_000})
    return {}


if __name__ == "__main__":  # a driver that the tests kill
    place, log = sys.argv[1:]
    with local(2) as pool:
        run_cases(plain, cases(60), shared={"log": log, "seconds": 0.05}, executor=pool, store=Store.open(place))
