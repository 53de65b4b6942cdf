"""BPMN without a service: reads process files, evaluates their expressions and executes processes.

It is pure: no network, no files, no clock of its own. `notation` reads a file into the `model`; `execution`
is the token engine; `languages` are expressions, `forms` what people fill in. The caller does the work:

    >>> from datetime import UTC, datetime
    >>> from handover_bpmn.definitions import Definitions
    >>> from handover_bpmn.execution.run import Run
    >>> from handover_bpmn.notation.file import read_bpmn
    >>> file = read_bpmn(b'''
    ... <definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="urn:example">
    ...   <process id="picking" isExecutable="true">
    ...     <startEvent id="start"/>
    ...     <sequenceFlow id="f1" sourceRef="start" targetRef="pick"/>
    ...     <userTask id="pick" name="Pick a part"/>
    ...     <sequenceFlow id="f2" sourceRef="pick" targetRef="enough"/>
    ...     <exclusiveGateway id="enough" default="f3"/>
    ...     <sequenceFlow id="f3" sourceRef="enough" targetRef="pick"/>
    ...     <sequenceFlow id="f4" sourceRef="enough" targetRef="end">
    ...       <conditionExpression>picked >= wanted</conditionExpression>
    ...     </sequenceFlow>
    ...     <endEvent id="end"/>
    ...   </process>
    ... </definitions>''')
    >>> library, now = Definitions(file.definitions), datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
    >>> run = Run.start(library.plans["picking"], {"wanted": 2}, now, library)
    >>> while open_activities := run.open():
    ...     print(open_activities[0].activity.name)
    ...     run.complete(open_activities[0].token, {"picked": open_activities[0].visit}, now)
    Pick a part
    Pick a part
    >>> run.completed
    True
"""
