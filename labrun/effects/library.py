"""The effects that are installed: entry points of group ``labrun.effects``."""

from collections.abc import Collection, Iterator

from labrun import registry
from labrun.effects.effect import Effect
from labrun.errors import ModelError, PluginError
from labrun.models.model import SiteKind
from labrun.toml import suggest

_GROUP = "labrun.effects"


def load_effect(name: str, kind: SiteKind | None = None) -> Effect:
    """Return an effect.

    Parameters
    ----------
    name
        An entry point's name or ``"package.module:EFFECT"``. The object is an `Effect`, or a tuple of effects that
        share the id at different kinds of sites.
    kind
        The kind of site it is for; needed where there is more than one.

    Raises
    ------
    PluginError
        Unknown, does not import, or is no effect.
    ModelError
        There is none for that kind of site, or there are several and `kind` is None.
    """
    effects = _of_plugin(name)
    fitting = [effect for effect in effects if kind in (None, effect.kind)]
    if len(fitting) == 1:
        return fitting[0]
    kinds = ", ".join(effect.kind for effect in effects)
    if not fitting:
        raise ModelError(f"effect {name} sits at {kinds} sites, not at a {kind} site")
    raise ModelError(f"effect {name} is there for {kinds} sites: say which")


def effects(without: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return every effect that is installed, in the order of their names.

    Parameters
    ----------
    without
        Names of plugins that are not even imported: one that is broken does no harm then.

    Raises
    ------
    PluginError
        A plugin does not import, or is no effect.
    """
    return tuple(_all(without))


def _all(without: Collection[str]) -> Iterator[Effect]:
    for name in registry.names(_GROUP):
        if name not in without:
            yield from _of_plugin(name)


def _of_plugin(name: str) -> tuple[Effect, ...]:
    found = registry.load(_GROUP, name)
    group = found if isinstance(found, tuple) else (found,)
    for effect in group:
        if not isinstance(effect, Effect):
            raise PluginError(
                f"effect plugin {name!r} gives {type(effect).__name__}, not labrun.effects.Effect",
                hint=suggest(name, registry.names(_GROUP)) if ":" not in name else None,
            )
    return group
