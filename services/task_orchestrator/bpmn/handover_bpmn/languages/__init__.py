"""Expression languages of BPMN files: ours, JUEL of Camunda 7 and FEEL of Camunda 8 (documented subsets)."""
