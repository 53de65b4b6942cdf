"""Cuts the polytopes of links into smaller ones where they refuse what the meshes allow.

The pair of links that is refused falsely most often is improved first: of the two polytopes that refuse most,
both are cut. Pairs whose meshes certainly never touch are left unchecked instead.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from lxml import etree

from handover_robots.model.robot_model import RobotModel
from handover_robots.model.srdf import LinkPair, Srdf
from handover_robots.onboarding.comparison import (
    Decided,
    MeshPairs,
    compare,
    decide,
    refusing_shapes,
)
from handover_robots.onboarding.hulls import Piece, split
from handover_robots.onboarding.meshes import Surfaces
from handover_robots.onboarding.semantics import (
    FROM_SRDF,
    excluded_pairs,
    never_touches,
)
from handover_robots.onboarding.shapes import write_pieces
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import link_of

SEED = 1
"""Of the configurations by which shapes are cut and pairs are excluded."""

AIM = 0.002
"""The share of falsely refused configurations of a pair at which no more is cut."""
ENOUGH = 0.01
"""The share at which a pair is given up that cuts no longer improve."""
MAX_CUTS_IN_VAIN = 3
"""So many cuts one after the other may reduce the share of a pair by less than a tenth, from `ENOUGH` on."""
MAX_PIECES_OF_LINK = 16
MAX_ROUNDS = 40


@dataclass(frozen=True)
class Shaping:
    """A robot whose shapes are made: `root` is its URDF, `pieces` are the parts of its links with meshes."""

    model: RobotModel
    root: Any
    pieces: dict[str, list[Piece]]
    surfaces: Surfaces

    def arm(self, excluded: Iterable[LinkPair]) -> Arm:
        """Write the present pieces into the URDF, and return the arm with them and with excluded pairs."""
        write_pieces(self.root, self.pieces)
        text = etree.tostring(self.root, encoding="unicode")
        return Arm(replace(self.model, urdf=text, disabled_pairs=frozenset(excluded)))

    def settle(self, srdf: Srdf, samples: int) -> dict[LinkPair, str]:
        """Cut the pieces until they refuse little falsely; return the pairs that need no check, with why."""
        arm = self.arm(srdf.disabled_pairs)
        decided = decide(arm, self.surfaces, samples, SEED)
        excluded = excluded_pairs(arm, decided, srdf)
        _refine(self, excluded, decided)
        return excluded


def _refine(shaping: Shaping, excluded: dict[LinkPair, str], decided: Decided) -> None:
    """Cut the pieces, and exclude pairs, until no pair is falsely refused too often, or none can be cut."""
    certain: dict[LinkPair, bool] = {}
    progress: dict[LinkPair, _Progress] = {}
    meshes: MeshPairs | None = None
    for _ in range(MAX_ROUNDS):
        arm = shaping.arm(excluded)
        comparison = compare(arm, decided, unchecked_on_purpose(excluded))
        refused = [shares for shares in comparison.pairs if shares.falsely_refused > AIM]
        changed = False
        for shares in sorted(refused, key=lambda shares: -shares.falsely_refused):
            pair = frozenset((shares.first, shares.second))
            if not progress.setdefault(pair, _Progress()).goes_on(shares.falsely_refused):
                continue
            if pair not in certain:
                meshes = meshes or MeshPairs(arm, shaping.surfaces)
                numbers = [number for number, links in enumerate(meshes.names) if links == pair]
                certain[pair] = shares.touching == 0 and never_touches(arm, meshes.geometry, numbers)
            if certain[pair]:
                excluded[pair] = "Never"
                changed = True
            else:
                changed = _cut(shaping.pieces, arm, decided, pair) or changed
        if not changed:
            break


@dataclass
class _Progress:
    """How the cuts of a pair have reduced its share of falsely refused configurations."""

    best: float = 1.0
    in_vain: int = 0

    def goes_on(self, share: float) -> bool:
        """Take note of the present share; say whether the pair is worth another cut."""
        if share < 0.9 * self.best:
            self.best, self.in_vain = share, 0
            return True
        self.in_vain += 1
        return share > ENOUGH or self.in_vain <= MAX_CUTS_IN_VAIN


def unchecked_on_purpose(excluded: dict[LinkPair, str]) -> set[LinkPair]:
    """Return the pairs that are not checked although their meshes may touch."""
    return {pair for pair, reason in excluded.items() if reason in {"Always", FROM_SRDF}}


def _cut(pieces: dict[str, list[Piece]], arm: Arm, decided: Decided, pair: LinkPair) -> bool:
    """Cut the two polytopes of a pair that refuse most. Return whether one was cut."""
    (worst, _), *_ = refusing_shapes(arm, decided, pair).most_common(1)
    changed = False
    for name in worst:
        link, number = link_of(name), int(name.rsplit("_", 1)[1])
        own = pieces.get(link, [])
        first = len([item for item in arm.solids.geometryObjects if link_of(item.name) == link]) - len(own)
        if number < first or len(own) >= MAX_PIECES_OF_LINK:
            continue
        parts = split(own[number - first])
        own[number - first : number - first + 1] = parts
        changed = changed or len(parts) > 1
    return changed
