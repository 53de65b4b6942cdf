"""The gains that people have chosen: shares of the stiffness and damping of the model, by chain.

The control cycle moves to them gradually. They are stored, and outlast the service and the cycle.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from handover.errors import Problem
from handover.messages import message
from handover.telemetry import get_logger
from handover_humanoid.model.humanoid import Humanoid

log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Shares:
    """Shares of the gains of the model."""

    stiffness: float = 1.0
    damping: float = 1.0


OF_THE_MODEL: Final = Shares()


class ChainGains:
    """The shares of each chain whose gains the model lets people change. Not thread-safe."""

    def __init__(self, model: Humanoid) -> None:
        self._model = model
        self.by_chain: Mapping[str, Shares] = self.defaults()

    def defaults(self) -> dict[str, Shares]:
        """Return the gains of the model."""
        return dict.fromkeys(self._model.gain_limits, OF_THE_MODEL)

    def restore(self, stored: Mapping[str, Shares]) -> None:
        """Take what was stored; what the model does not permit any more is left out."""
        by_chain = self.defaults()
        for chain, shares in stored.items():
            try:
                self._require(chain, shares)
            except Problem as problem:
                log.warning("stored gains left out", chain=chain, reason=str(problem.detail))
            else:
                by_chain[chain] = shares
        self.by_chain = by_chain

    def changed(self, wanted: Mapping[str, Shares]) -> dict[str, Shares]:
        """Return all shares with the wanted ones. Raises `Problem` 422 for one beyond the limits."""
        for chain, shares in wanted.items():
            self._require(chain, shares)
        return {**self.by_chain, **wanted}

    def port_values(self, names: Sequence[str]) -> list[float]:
        """Return the values of the port `gains`."""
        by_name = {f"{chain}.stiffness": shares.stiffness for chain, shares in self.by_chain.items()}
        by_name |= {f"{chain}.damping": shares.damping for chain, shares in self.by_chain.items()}
        return [by_name.get(name, 1.0) for name in names]

    def _require(self, chain: str, shares: Shares) -> None:
        limits = self._model.gain_limits
        if chain not in limits:
            raise Problem.translated(
                422,
                "Unknown chain",
                "humanoid.no_gains_of_chain",
                'the gains of "{chain}" cannot be changed; the model permits: {chains}',
                chain=chain,
                chains=", ".join(limits) or "-",
            )
        _require_within(chain, "stiffness", shares.stiffness, limits[chain].stiffness)
        _require_within(chain, "damping", shares.damping, limits[chain].damping)


def _require_within(chain: str, kind: str, share: float, limits: tuple[float, float]) -> None:
    least, most = limits
    if least <= share <= most:
        return
    text = (
        message(
            "humanoid.stiffness_out_of_limits",
            'the stiffness of "{chain}" must be {least} to {most} % of that of the model, not {share} %',
            chain=chain,
            share=f"{100 * share:g}",
            least=f"{100 * least:g}",
            most=f"{100 * most:g}",
        )
        if kind == "stiffness"
        else message(
            "humanoid.damping_out_of_limits",
            'the damping of "{chain}" must be {least} to {most} % of that of the model, not {share} %',
            chain=chain,
            share=f"{100 * share:g}",
            least=f"{100 * least:g}",
            most=f"{100 * most:g}",
        )
    )
    raise Problem(422, "Out of limits", text)
