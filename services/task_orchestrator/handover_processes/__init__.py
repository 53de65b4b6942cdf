"""The task orchestrator: a BPMN process becomes Tasks for people and robots."""
