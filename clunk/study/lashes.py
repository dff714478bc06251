"""Names of lashes, by which keys, results and commands tell several of them apart."""

from collections.abc import Sequence

from clunk.study.problems import ConfigError, listing, shorten


def lash_name(position: int, name: str | None) -> str:
    """Name of the lash at a position in its config, which may leave it out."""
    return name or f"lash {position + 1}"


def lash_position(name: str | None, names: Sequence[str]) -> int:
    """Position of the lash of a name or number from 1 among those with these names; of None, the first.

    Raises
    ------
    ConfigError
        Where there is none.
    """
    if name is None or name in names:
        return 0 if name is None else list(names).index(name)
    if name.isdecimal() and 1 <= int(name) <= len(names):
        return int(name) - 1
    there = f"there are {listing(names)}" if len(names) > 1 else f"there is only {names[0]}"
    raise ConfigError(f"There is no lash {shorten(name)}; {there}.")
