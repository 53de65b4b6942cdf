"""Routes: deploy forms, alone or together with BPMN files, and read them."""

from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response
from starlette.responses import JSONResponse

from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_bpmn.forms.form_js import MAX_FORM_BYTES
from handover_bpmn.notation.document import MAX_BYTES
from handover_bpmn.notation.faults import as_json
from handover_processes.documents.definitions import definition_view
from handover_processes.documents.document import document, documents, json_response
from handover_processes.documents.forms import DeployedFiles, FormView
from handover_processes.documents.requests import MAX_VERSION, DeploymentRequest
from handover_processes.operations.deployments import DeployedForm
from handover_processes.running.components import Components

Version = Annotated[int | None, Query(ge=1, le=MAX_VERSION)]
FileName = Annotated[
    str | None, Query(max_length=300, description="the name of the file, such as check.form")
]


def add_forms(app: FastAPI, at: Components) -> None:
    """Add the routes of forms and of deployments of several files."""
    routes = TaggedRoutes(app, "forms")
    deployments, state = at.orchestrator.deployments, at.orchestrator.state
    forms = state.allocator.forms

    @routes.post(
        "/forms",
        status_code=201,
        responses={201: {"model": FormView}, 200: {"model": FormView}},
        dependencies=[require(Permission.DEPLOY_PROCESSES)],
    )
    @max_body(2 * MAX_FORM_BYTES)
    async def deploy_form(request: Request, file: FileName = None) -> JSONResponse:
        """Deploy a form of form-js (the body is its JSON): 201 for a new version, 200 if it is deployed."""
        deployed = await deployments.deploy_files([], [(file, await request.body())])
        return JSONResponse(_view(deployed.forms[0]), 201 if deployed.created else 200)

    @routes.get("/forms", responses={200: {"model": list[FormView]}}, dependencies=[require(Permission.READ)])
    async def list_forms() -> Response:
        """Return the latest version of every form."""
        return json_response(documents(FormView, forms.latest()))

    @routes.get("/forms/{form_id}", response_model=dict[str, Any], dependencies=[require(Permission.READ)])
    async def form(form_id: str, version: Version = None) -> Response:
        """Return a form as it was deployed."""
        return Response(forms.record(form_id, version).content, media_type="application/json")

    @app.post(
        "/deployments",
        status_code=201,
        tags=["definitions"],
        responses={201: {"model": DeployedFiles}, 200: {"model": DeployedFiles}},
        dependencies=[require(Permission.DEPLOY_PROCESSES)],
    )
    @max_body(4 * MAX_BYTES)
    async def deploy_files(body: DeploymentRequest) -> JSONResponse:
        """Deploy BPMN files and forms together, all or none: 201 if anything is new, else 200."""
        bpmn = [file.content.encode() for file in body.files if file.name.endswith(".bpmn")]
        form_files = [
            (file.name, file.content.encode()) for file in body.files if file.name.endswith(".form")
        ]
        deployed = await deployments.deploy_files(bpmn, form_files)
        registry = state.registry
        content = {
            "definitions": [
                definition_view(registry, registry.record(deployment.name, deployment.version))
                for deployment in deployed.bpmn.deployments
            ],
            "forms": [_view(deployed_form) for deployed_form in deployed.forms],
            "warnings": as_json(deployed.bpmn.warnings),
            "created": deployed.created,
        }
        return JSONResponse(content, 201 if deployed.created else 200)


def _view(deployed: DeployedForm) -> FormView:
    warnings = [str(warning) for warning in deployed.warnings]
    return document(FormView, deployed.record, created=deployed.created, warnings=warnings)
