"""Functions of FEEL; an argument of the wrong type makes the result null."""

from collections.abc import Mapping

from handover_bpmn.languages.feel.dates import DATE_FUNCTIONS
from handover_bpmn.languages.feel.function import Function
from handover_bpmn.languages.feel.lists import LIST_FUNCTIONS
from handover_bpmn.languages.feel.numbers import NUMBER_FUNCTIONS
from handover_bpmn.languages.feel.texts import TEXT_FUNCTIONS

FUNCTIONS: Mapping[str, Function] = {**TEXT_FUNCTIONS, **LIST_FUNCTIONS, **NUMBER_FUNCTIONS, **DATE_FUNCTIONS}
"""The functions by name; `now` and `today` depend on the variables and are part of the parser."""
