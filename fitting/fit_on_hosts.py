"""Fit one material to a folder of photographs with several processes, on one machine or one a host.

All here: fit_on_hosts.py FOLDER --processes 2
Host k of two: fit_on_hosts.py FOLDER --processes 2 --process k --coordinator HOST0:PORT
Every process reads the folder, in DiLiGenT's layout. Exit status: 0 done; 1 an error, said in a sentence;
75 a process was lost: the same command, again, goes on from the checkpoint.
"""

import argparse
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax

import diffshade as ds

LOST = 75  # EX_TEMPFAIL of sysexits.h: try again
HEARTBEAT = 20  # seconds in which a silent process is missed


def main() -> None:
    """Take part in a fit, or start those who do and say how they ended."""
    parser = argparse.ArgumentParser(
        usage="%(prog)s FOLDER [options]", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="in all (default: 2)")
    parser.add_argument("--process", type=int, metavar="K", help="start this one alone (default: all, here)")
    parser.add_argument("--coordinator", metavar="HOST:PORT", help="of process 0 (default: a free port, here)")
    parser.add_argument("--devices", type=int, default=1, metavar="N", help="CPU devices a process (default: 1)")
    parser.add_argument("--memory", type=float, default=4e9, metavar="BYTES", help="of pixels laid out (default: 4e9)")
    parser.add_argument("--checkpoint", type=Path, default=Path("output/fit_on_hosts"), metavar="DIR")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        work(arguments)
    else:
        start(arguments)


def start(arguments: argparse.Namespace) -> None:
    """Start the processes of this machine, each as this script again."""
    if arguments.process is not None and arguments.coordinator is None:
        raise ValueError("--process needs --coordinator. Give HOST:PORT of process 0, the same on every host.")
    coordinator = arguments.coordinator or f"127.0.0.1:{free_port()}"
    numbers = range(arguments.processes) if arguments.process is None else [arguments.process]
    command = [sys.executable, *(f"-W{option}" for option in sys.warnoptions), *sys.argv, "--work"]
    command += ["--coordinator", coordinator, "--process"]
    quiet = [None, *[subprocess.PIPE] * (len(numbers) - 1)]  # what all of them say is said once
    end([subprocess.Popen([*command, str(k)], stderr=to, text=True) for k, to in zip(numbers, quiet, strict=True)])


def end(workers: list[subprocess.Popen]) -> None:
    """Wait for the processes; once one has failed, the others are of no use: end with the status of the worst."""
    while any(worker.poll() is None for worker in workers) and not any(worker.poll() for worker in workers):
        time.sleep(0.05)
    for worker in workers:
        try:
            worker.wait(5 if any(other.poll() for other in workers) else None)
        except subprocess.TimeoutExpired:
            worker.kill()
    said = [worker.communicate()[1] or "" for worker in workers]
    wrong = [words for worker, words in zip(workers, said, strict=True) if worker.returncode == 1]
    if wrong:
        print(wrong[0], end="", file=sys.stderr)  # the first one's is on the terminal already
        sys.exit(1)
    if any(worker.returncode for worker in workers):  # lost; or ended by JAX's runtime, which missed another one first
        print("fit_on_hosts: a process was lost. Give the same command again to go on.", file=sys.stderr)
        sys.exit(LOST)


def work(arguments: argparse.Namespace) -> None:
    """Take part in the fit."""
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(
        arguments.coordinator, arguments.processes, arguments.process, heartbeat_timeout_seconds=HEARTBEAT
    )
    scene, views = ds.read_photographs(arguments.folder)
    fit = ds.fit(
        scene,
        views,
        free=("k_a", "k_d", "k_s", "n_s"),
        memory=arguments.memory,
        checkpoint=arguments.checkpoint,
        mesh=jax.sharding.Mesh(jax.devices(), ("devices",)),
        progress=arguments.process == 0,
    )
    if arguments.process == 0:
        print(fit)


def free_port() -> int:
    """Return a port of this machine that nobody uses."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


if __name__ == "__main__":
    try:
        main()
    except ds.LostProcess:
        os._exit(LOST)  # at once: JAX's own way out waits for the lost one, and then aborts
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
        print(f"fit_on_hosts: {error}", file=sys.stderr, flush=True)
        os._exit(1)
