"""Several devices at once, real drivers on loopback: is every sample there, and how evenly do commands go out?

    python benchmarks/streams.py [--minutes 10] [--arm-hz 500]

A Net F/T box at 7 kHz (UDP), motion capture at 360 Hz (UDP), an arm's controller at 125 or 500 Hz (TCP), a Robotiq
FT300 at 100 Hz (serial), and four servos that get set-points at 100 Hz (serial), each emulated in a process of its own;
one process reads them all every 20 ms, as the runner does. For every stream: samples received, samples its driver
counted as lost, messages its emulator sent (which are the samples, and the few answers to requests), rate, jitter of
the device's own time stamps, and what their clock does against the host's: offset and drift. For the commands: sent,
skipped, and how late.
"""

import argparse
import json
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from measuring import machine, table

from labrun.devices import DeviceContext, Samples, Trajectory
from labrun.runner import EmulatedBench, RealClock, resolve_device
from labrun.signals import Signals
from labrun.store import stream_report
from labrun.toml import PluginTable

LOOK_S = 0.02
_CB3_HZ = 125.0
"""A controller of the CB3 series gives no more; faster ones are of the e-Series."""
_LIMITS = {"angle_deg": [-60.0, 60.0], "speed_deg_s": 528.0}
_FINS = ("right_1", "right_2", "left_1", "left_2")


def rigs(arm_hz: float) -> list[tuple[str, dict[str, dict[str, Any]]]]:
    """Return the benches, and the devices on each."""
    fish = {
        "fins": {
            "plugin": "dynamixel", "port": "/dev/ttyUSB0", "limits": _LIMITS,
            "joints": {joint: {"id": number + 1} for number, joint in enumerate(_FINS)},
        },
        "net-ft": {"plugin": "ati-netft", "host": "192.168.1.1", "rate_hz": 7000, "calibration": "SI-80-4"},
        "ft300": {"plugin": "robotiq-ft300", "port": "/dev/ttyUSB1"},
        "arm": {"plugin": "ur5", "host": "192.168.1.2", "rate_hz": arm_hz},
    }  # fmt: skip
    cameras = {"cameras": {"plugin": "optitrack", "host": "192.168.1.10", "rate_hz": 360, "bodies": ["arm"]}}
    return [("fire-tank", fish), ("hinge-bench", cameras)]


def swing(duration_s: float) -> Trajectory:
    """Return a sine of 1 Hz and 20 deg for all fins."""
    time_s = np.arange(0.0, duration_s, 0.01)
    angle_rad = np.radians(20.0) * np.sin(2 * np.pi * time_s)
    return Trajectory(_FINS, time_s, np.column_stack([angle_rad] * len(_FINS)), 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--arm-hz", type=float, default=500.0)
    given = parser.parse_args()
    duration_s = 60.0 * given.minutes
    clock = RealClock()
    print(machine("numpy", "pyserial"))
    devices: dict[str, Any] = {}
    blocks: dict[str, list[Samples]] = {}
    with tempfile.TemporaryDirectory() as logs:
        with ExitStack() as stack:
            benches = []
            for scene, tables in rigs(given.arm_hz):
                made = {name: PluginTable.model_validate(item) for name, item in tables.items()}
                faults = {"arm": {"e-series": True}} if given.arm_hz > _CB3_HZ else None
                bench = stack.enter_context(
                    EmulatedBench(made, PluginTable(plugin=scene), seed=1, faults=faults)
                )
                bench.keep_logs(Path(logs))
                benches.append(bench)
                for name in made:
                    item = resolve_device(name, bench.table(name), dry_run=False)
                    devices[name] = item.make(
                        name, item.settings, DeviceContext(clock, np.random.default_rng(1))
                    )
            for name, device in devices.items():
                device.open()
                stack.callback(device.close)
                stack.callback(device.safe_stop)
                if hasattr(device, "read") and name != "fins":
                    blocks[name] = []
            for name in blocks:
                devices[name].start()
            devices["fins"].follow(swing(duration_s), clock.now() + 0.1)
            end_s = clock.now() + duration_s
            while clock.now() < end_s:
                clock.sleep(LOOK_S)
                for name, block in blocks.items():
                    block.append(devices[name].read())
            pacing = devices["fins"].pacing()
            for name, block in blocks.items():
                block.append(devices[name].read())
                devices[name].stop()
        sent = {name: sent_by(Path(logs) / f"{name}.jsonl") for name in blocks}
    rows = [row(name, block, sent[name], devices[name].rate_hz) for name, block in blocks.items()]
    print(
        table(
            [
                "stream",
                "received",
                "lost",
                "sent",
                "rate (Hz)",
                "jitter sd (ms)",
                "offset (s)",
                "drift (ppm)",
            ],
            rows,
        )
    )
    print(
        f"\ncommands  {pacing.sent} sent at {pacing.rate_hz:g} Hz, {pacing.missed} skipped; late by "
        f"{1e3 * pacing.late_median_s:.2f} ms (median), {1e3 * pacing.late_p99_s:.2f} ms (99 %), "
        f"{1e3 * pacing.late_worst_s:.1f} ms (worst)"
    )


def sent_by(log: Path) -> int:
    """Return how many messages an emulator sent, by its own log."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return max((line["sent"] for line in lines if line["event"] == "closed"), default=0)


def row(name: str, results: list[Samples], sent: int, rate_hz: float) -> list[str]:
    """Return one stream's figures, by the means of the run's own report."""
    samples = Samples.join(results, results[0].values.shape[1])
    columns = tuple(map(str, range(samples.values.shape[1])))
    signals = Signals(
        name, columns, ("",) * len(columns), samples.device_time_s - samples.device_time_s[0], samples.values, {},
        samples.device_time_s, samples.host_time_s, rate_hz, samples.lost,
    )  # fmt: skip
    report = stream_report(signals)
    drift = "" if report.drift_ppm is None else f"{report.drift_ppm:.1f}"
    return [
        name, str(len(samples)), str(samples.lost), str(sent), f"{report.rate_hz:.2f}", f"{1e3 * report.jitter_s:.3f}",
        f"{report.offset_s:.4f}", drift,
    ]  # fmt: skip


if __name__ == "__main__":
    main()
