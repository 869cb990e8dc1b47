"""Names of channels, "device.channel", against what the devices measure."""

from collections.abc import Iterator, Mapping

from labrun.spec.catalogue import DeviceInfo
from labrun.toml import Fault, KeyPath, nearest, suggest


def check_channel(channel: object, path: KeyPath, devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    """Yield what is wrong with a channel's name, "device.channel"."""
    if not isinstance(channel, str):
        return
    name, _, signal = channel.partition(".")
    known = [f"{key}.{item}" for key, device in devices.items() for item in device.channels or ()]
    if name not in devices:
        near = nearest(channel, known)
        hint = f'did you mean "{near}"?' if near else suggest(name, devices, kind="devices")
        yield Fault(path, f'there is no device "{name}"; {hint}', at_value=True)
        return
    channels = devices[name].channels
    if not signal:
        hint = suggest(channel, known, kind="channels")
        yield Fault(path, f'a channel is written "device.channel"; {hint}', at_value=True)
    elif channels is not None and signal not in channels:
        own = [f"{name}.{item}" for item in channels]
        hint = suggest(channel, own, kind="channels") if own else f"{name} measures nothing"
        yield Fault(path, f'{name} has no channel "{signal}"; {hint}', at_value=True)
