"""Which messages of a file are asked for, and which of its topics can be read."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.engine.channels import Catalogue, TopicPlan
from turtlelog.log.engine.json_messages import keep_flat

EVER: Final = 2**64
"""A log time after all others [ns]."""

_MOST_REASONS: Final = 3
"""Topics that an error names with their reasons."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Which messages are asked for.

    Attributes:
        topics: By name; None for all that can be understood.
        start_ns: Least log time.
        end_ns: The log time before which they end.
        is_lenient: Whether topics may be missing or not understood; then all chunks are read and
            checked.
        is_flat: Whether fields must be numbers and texts, not sequences of texts or messages: those
            take some hundred times the memory of their bytes.
        is_counted: Whether rows may take only as much as the size of the file lets expect.
        kept: By topic: the only columns that its rows keep, log time among them; of others all.
    """

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = EVER
    is_lenient: bool = False
    is_flat: bool = False
    is_counted: bool = False
    kept: Mapping[str, Collection[str]] = field(default_factory=dict)

    @property
    def is_ever(self) -> bool:
        """Whether no message is left out for its time."""
        return self.start_ns <= 0 and self.end_ns >= EVER

    def choose_plans(self, catalogue: Catalogue) -> dict[str, TopicPlan]:
        """Return the plans of the topics asked for, as far as they are known so far.

        Raises:
            LogError: Where one that is asked for by name cannot be understood.
        """
        plans = {}
        known = catalogue.topics
        for topic in sorted(known if self.topics is None else self.topics.intersection(known)):
            plan = self.choose_plan(catalogue, topic)
            if plan is not None:
                plans[topic] = plan
        return plans

    def choose_plan(self, catalogue: Catalogue, topic: str) -> TopicPlan | None:
        """Return the plan of a topic, None where it is not asked for.

        Raises:
            LogError: Where it is asked for by name and cannot be understood.
        """
        if self.topics is not None and topic not in self.topics:
            return None
        plan = catalogue.find_plan(topic)
        if plan.reason and self.topics is not None and not self.is_lenient:
            raise LogError(plan.describe_reason())
        if self.is_flat and plan.sequence is not None:
            expected = "fields of numbers and texts"
            raise LogError(
                f"topic {topic}: expected {expected}, found the sequence {plan.sequence}"
            )
        if self.is_flat and plan.json is not None:
            plan = replace(plan, json=keep_flat(plan.json))
        return None if plan.reason else plan

    def require_topics(self, catalogue: Catalogue) -> None:
        """Check that every topic asked for by name is there; where none is, that one can be read.

        Raises:
            LogError: Where one is not, or no topic of the file can be understood.
        """
        if self.topics is None and not self.is_lenient:
            plans = [catalogue.find_plan(topic) for topic in sorted(catalogue.topics)]
            if plans and all(plan.reason for plan in plans):
                raise LogError("; ".join(plan.describe_reason() for plan in plans[:_MOST_REASONS]))
        missing = (self.topics or frozenset()).difference(catalogue.topics)
        for topic in () if self.is_lenient else sorted(missing):
            raise LogError(f"topic {topic}: expected it in the file, found no such topic")
