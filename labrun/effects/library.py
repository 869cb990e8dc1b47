"""The effects there are: those of labrun's own TOML files, and entry points of group ``labrun.effects``."""

import functools
from collections.abc import Collection
from pathlib import Path

from labrun import registry
from labrun.effects.effect import Effect, SiteKind
from labrun.effects.reading import read_effects
from labrun.errors import ModelError, PluginError
from labrun.toml import suggest

_GROUP = "labrun.effects"


def load_effect(name: str, kind: SiteKind | None = None) -> Effect:
    """Return an effect.

    Parameters
    ----------
    name
        The id of an effect that ships with labrun, or that a plugin brings; ``"file.toml:id"``; or
        ``"package.module:EFFECT"``, where the object is an `Effect`, or a tuple of effects that share the id at
        different kinds of sites.
    kind
        The kind of site it is for; needed where there is more than one.

    Raises
    ------
    PluginError
        Unknown, does not import, or is no effect.
    ModelError
        There is none for that kind of site, or there are several and `kind` is None; or its file does not hold.
    """
    named = _named(name)
    fitting = [effect for effect in named if kind in (None, effect.kind)]
    if len(fitting) == 1:
        return fitting[0]
    kinds = ", ".join(effect.kind for effect in named)
    if not fitting:
        raise ModelError(f"effect {name} sits at {kinds} sites, not at a {kind} site")
    raise ModelError(f"effect {name} is there for {kinds} sites: say which")


def effects(without: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return every effect that ships with labrun or is installed, in the order of their names.

    Parameters
    ----------
    without
        Names of effects, or of plugins that are then not even imported: one that is broken does no harm.

    Raises
    ------
    PluginError
        A plugin does not import, or is no effect.
    """
    found = [(effect.id, effect) for effect in shipped() if effect.id not in without]
    for plugin in registry.names(_GROUP):
        if plugin not in without:
            found += [(plugin, effect) for effect in _of_plugin(plugin)]
    return tuple(effect for _, effect in sorted(found, key=lambda one: one[0]))


@functools.cache
def shipped() -> tuple[Effect, ...]:
    """Return the effects that ship with labrun."""
    files = sorted(Path(__file__).parent.glob("*.toml"))
    return tuple(effect for file in files for effect in read_effects(file, origin=""))


def _named(name: str) -> tuple[Effect, ...]:
    file, colon, id_ = name.rpartition(":")
    if colon and file.endswith(".toml"):
        there = read_effects(Path(file))
        if found := tuple(effect for effect in there if effect.id == id_):
            return found
        raise PluginError(f"{file} has no effect {id_!r}", hint=suggest(id_, {effect.id for effect in there}))
    own = tuple(effect for effect in shipped() if effect.id == name)
    if own or colon or registry.is_installed(_GROUP, name):
        return own or _of_plugin(name)
    # a plugin may bring a whole file of effects under a name of its own
    brought = tuple(effect for effect in effects() if effect.id == name)
    if brought:
        return brought
    known = [*(effect.id for effect in effects()), *registry.names(_GROUP)]
    raise PluginError(f"unknown effect plugin {name!r}", hint=suggest(name, known))


def _of_plugin(name: str) -> tuple[Effect, ...]:
    found = registry.load(_GROUP, name)
    group = found if isinstance(found, tuple) else (found,)
    for effect in group:
        if not isinstance(effect, Effect):
            raise PluginError(
                f"effect plugin {name!r} gives {type(effect).__name__}, not labrun.effects.Effect"
            )
    return group
