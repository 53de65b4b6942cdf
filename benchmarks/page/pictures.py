"""Make the pictures of the documentation from the running product.

    python -m benchmarks.page.pictures [--only work,system] [--out webui/pictures] [--all-looks DIR]

It starts `handover up` with a glove and a simulated robot in a temporary folder, takes screenshots in
headless Chromium, and records the Work page while a gesture confirms a Task (`confirm.webp`). With
`--all-looks` it also takes every page in both themes, three languages and four sizes, for review.

The person at the glove, the one who catches balls, the one with body sensors, the accuracy test and the
answers of the study are invented.
"""

import argparse
import io
import math
import random
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
import orjson
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from websockets.sync.client import connect

from benchmarks.cell.handover import environment, stop, up
from benchmarks.free_ports import free_ports
from benchmarks.page.screen import installed_chromium
from handover_datamodels.times import iso
from handover_devices.device_client import DeviceClient
from handover_devices.model.description import DeviceDescription
from handover_devices.simulation import SimulatedDevice, examples
from tests.kit.chromium import FLAGS

OUT = Path(__file__).parents[2] / "webui" / "pictures"
SIZE = {"width": 1280, "height": 800}
TALL = {"width": 1280, "height": 1180}
FRAMES_HZ = 50
STRAIGHT, BENT, NOISE = (1250, 2050, 2050, 2150, 2200), (500, 320, 280, 400, 420), 14
TIMEOUT_MS = 60_000
MAX_ANIMATION_BYTES = 2_000_000
ANIMATION_SIZE = (960, 600)

LOOKS = {
    "laptop": {"width": 1280, "height": 800},
    "phone": {"width": 390, "height": 844},
    "tablet": {"width": 820, "height": 1180},
    "4k": {"width": 3840, "height": 2160},
}
PAGES = {
    "start": "/", "work": "/work?glove=glove-1", "processes": "/processes", "tasks": "/tasks",
    "cockpit": "/cockpit?of=bin-picking", "offers": "/processes/offers", "mapping": "/cockpit?view=mapping",
    "system": "/system", "alerts": "/system?tab=alerts", "events": "/system?tab=events",
    "robots": "/system?tab=robots",
    "sensors": "/sensors", "devices": "/devices?device=sim-panda",
    "health": "/health", "humanoid": "/humanoid", "humanoid-vr": "/humanoid/vr",
    "people": "/people", "calibrate": "/calibrate?glove=glove-1", "test": "/test", "study": "/study",
}  # fmt: skip
INITIAL_ORDER = 4711
WORKING_BPM = 100
"""The heart rate of a person of 40 years who works moderately hard."""
ONE_TASK = """<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="urn:pictures">
  <bpmn:process id="{name}" name="{title}" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:userTask id="work" name="{title}" {attributes}/>
    <bpmn:endEvent id="end"/>
    <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="work"/>
    <bpmn:sequenceFlow id="b" sourceRef="work" targetRef="end"/>
  </bpmn:process>
</bpmn:definitions>"""
INSPECTED = 'camunda:formKey="camunda-forms:deployment:inspection.form" camunda:candidateGroups="quality"'
PEOPLE_TASKS = (
    ("inspection", "Inspect the part", f'{INSPECTED} camunda:dueDate="PT3H" camunda:priority="80"'),
    ("packing", "Pack the box", 'camunda:candidateGroups="packing" camunda:dueDate="P1D"'),
    ("rework", "Rework the seam", 'camunda:assignee="anna" camunda:dueDate="-PT2H"'),
    ("report", "Write the shift report", ""),
    ("greasing", "Grease the axis", 'camunda:followUpDate="P2D"'),
)
INSPECTION_FORM = {
    "type": "default",
    "id": "inspection",
    "components": [
        {
            "type": "number", "key": "weight", "label": "Weight", "validate": {"required": True, "max": 20},
            "appearance": {"suffixAdorner": "kg"},
        },
        {
            "type": "radio", "key": "colour", "label": "Colour",
            "values": [{"label": "Red", "value": "red"}, {"label": "Green", "value": "green"}],
        },
        {"type": "checkbox", "key": "damaged", "label": "Damaged"},
    ],
}  # fmt: skip
LOCALES = {"en": "en-GB", "de": "de-DE", "fi": "fi-FI"}


class MovingHand:
    """A glove that sends frames in real time from a thread; the fingers move smoothly to the shown code."""

    def __init__(self, port: int) -> None:
        self._code = "00000"
        self._bend = [float(value) for value in STRAIGHT]
        self._ended = threading.Event()
        self._port = port
        self._link = self._connect()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def show(self, code: str) -> None:
        """Move to five finger states, thumb first."""
        self._code = code

    def close(self) -> None:
        """Disconnect."""
        self._ended.set()
        self._thread.join()
        self._link.close()

    def _run(self) -> None:
        noise = random.Random(7)
        while not self._ended.wait(1 / FRAMES_HZ):
            now_s = time.monotonic()
            for finger, state in enumerate(self._code):
                target = (STRAIGHT if state == "0" else BENT)[finger]
                self._bend[finger] += 0.2 * (target - self._bend[finger])
            sway = 20 * math.sin(now_s)
            bend = [round(value + sway + noise.gauss(0, NOISE)) for value in self._bend]
            self._send({"type": "frame", "t": round(now_s, 3), "bend": bend})

    def _connect(self) -> socket.socket:
        link = socket.create_connection(("127.0.0.1", self._port), timeout=10)
        hello = {"type": "hello", "version": 1, "glove": "glove-1", "hand": "right"}
        link.sendall(orjson.dumps(hello) + b"\n")
        link.recv(4096)
        link.settimeout(None)  # else MSG_DONTWAIT would wait for the timeout
        return link

    def _send(self, frame: dict[str, Any]) -> None:
        """Send a frame and discard the acknowledgements; connect again if the controller has disconnected."""
        try:
            self._link.sendall(orjson.dumps(frame) + b"\n")
            with suppress(BlockingIOError):
                self._link.recv(65536, socket.MSG_DONTWAIT)
        except OSError:
            self._link.close()
            self._link = self._connect()


class Product:
    """The running services, a glove, and a browser."""

    def __init__(self, env: dict[str, str], browser: Browser, out: Path) -> None:
        self.base = f"http://127.0.0.1:{env['HANDOVER_WEBUI_PORT']}"
        self.http = httpx.Client(base_url=f"{self.base}/api", timeout=60, trust_env=False)
        self.hand = MovingHand(int(env["HANDOVER_GLOVE_PORT"]))
        self.humanoid = f"ws://127.0.0.1:{env['HANDOVER_WHOLE_BODY_PORT']}"
        self.out = out
        self._browser = browser
        self._orders = 0

    @contextmanager
    def page(
        self, path: str, *, language: str = "en", theme: str = "light", **options: Any
    ) -> Iterator[Page]:
        """Open a page of the product."""
        context = self._browser.new_context(
            base_url=self.base,
            viewport=options.pop("viewport", SIZE),
            locale=LOCALES[language],
            color_scheme=theme,
            **options,
        )
        context.set_default_timeout(TIMEOUT_MS)
        context.add_init_script("localStorage.setItem('handover.who', 'Anna')")
        page = context.new_page()
        page.goto(path)
        yield page
        context.close()

    def keep(self, page: Page, name: str) -> None:
        """Save a screenshot."""
        page.evaluate("Promise.allSettled(document.getAnimations().map((one) => one.finished))")
        page.screenshot(path=self.out / f"{name}.png")

    def post(self, path: str, **json: Any) -> Any:
        """POST to a service and return the JSON of the response."""
        return self.http.post(path, json=json).raise_for_status().json()

    def glove(self) -> dict[str, Any]:
        """Return the view of the glove."""
        return dict(self.http.get("/gesture-controller/gloves/glove-1").raise_for_status().json())

    def start_process(self) -> str:
        """Start bin picking with an unused business key and return the id."""
        key = self.next_order()
        return str(self.post("/task-orchestrator/processes", definition="bin-picking", key=key)["id"])

    def next_order(self) -> str:
        """Return an unused business key."""
        self._orders += 1
        return f"order {INITIAL_ORDER + self._orders - 1}"

    def prompted_code(self) -> str:
        """Return the code of the gesture that the glove is prompted for, as soon as there is a Task."""
        wait_until(lambda: (self.glove()["task"] or {}).get("status") == "inProgress")
        return str(self.glove()["task"]["code"])

    def complete(self, process: str) -> None:
        """Answer every prompt of a process with its gesture until the process ends."""
        while self.http.get(f"/task-orchestrator/processes/{process}").json()["endedAt"] is None:
            self.answer()
            time.sleep(0.2)
        self.hand.show("00000")

    def answer(self) -> None:
        """Show the gesture of the current prompt, or the open hand without one."""
        task = self.glove()["task"]
        self.hand.show(task["code"] if task and task["status"] == "inProgress" else "00000")


def wait_until(condition: Callable[[], Any], timeout_s: float = 60.0) -> None:
    """Wait until `condition` holds; raises `TimeoutError`."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise TimeoutError("the product did not reach the state for a picture")
        time.sleep(0.1)


def work(product: Product) -> None:
    """The Work page while the gesture is held, and the animation of the confirmation."""
    with product.page("/work?glove=glove-1") as page:
        process = product.start_process()
        code = product.prompted_code()
        page.locator("[data-situation='prompt']").wait_for()
        time.sleep(2)
        frames = [(time.monotonic(), page.screenshot(type="jpeg", quality=92))]
        product.hand.show(code)
        pictured = False
        ends_s = time.monotonic() + 30
        while time.monotonic() < ends_s:
            frames.append((time.monotonic(), page.screenshot(type="jpeg", quality=92)))
            if not pictured and product.glove()["hold"]["heldMs"] > 700:
                page.screenshot(path=product.out / "work.png")
                pictured = True
            if page.locator("[data-situation='answered']").count():
                ends_s = min(ends_s, time.monotonic() + 2.5)
                product.hand.show("00000")
        animate(frames, product.out / "confirm.webp")
        product.complete(process)


def animate(frames: list[tuple[float, bytes]], path: Path) -> None:
    """Write frames with their times (s) as an animated WebP below `MAX_ANIMATION_BYTES`."""
    pictures = [Image.open(io.BytesIO(data)).convert("RGB").resize(ANIMATION_SIZE, Image.Resampling.LANCZOS)
                for _, data in frames]  # fmt: skip
    durations_ms = [round(1000 * (after - at)) for (at, _), (after, _) in pairwise(frames)]
    durations_ms = [900, *durations_ms[1:], 1500]
    for quality in (80, 60, 40, 25):
        pictures[0].save(
            path,
            save_all=True,
            append_images=pictures[1:],
            duration=durations_ms,
            loop=0,
            quality=quality,
            method=6,
        )
        if path.stat().st_size <= MAX_ANIMATION_BYTES:
            return
    raise SystemExit(f"{path} is larger than {MAX_ANIMATION_BYTES} bytes")


def processes(product: Product) -> None:
    """A running process with its diagram and timeline."""
    product.complete(product.start_process())
    running = product.start_process()
    product.hand.show(product.prompted_code())
    time.sleep(4)
    product.hand.show("00000")
    with product.page(f"/processes/{running}") as page:
        page.locator(".djs-container").wait_for()
        time.sleep(3)
        product.keep(page, "processes")
    product.complete(running)


def tasks(product: Product) -> None:
    """The tasklist with a claimed Task and its form."""
    files = [{"name": "inspection.form", "content": orjson.dumps(INSPECTION_FORM).decode()}]
    files += [
        {"name": f"{name}.bpmn", "content": ONE_TASK.format(name=name, title=title, attributes=attributes)}
        for name, title, attributes in PEOPLE_TASKS
    ]
    product.post("task-orchestrator/deployments", files=files)
    for name, _, _ in PEOPLE_TASKS:
        product.post("task-orchestrator/processes", definition=name, key=product.next_order())
    listed = product.http.get("task-orchestrator/tasks").raise_for_status().json()
    task = next(listed_task["id"] for listed_task in listed if listed_task["name"] == "Inspect the part")
    product.post(f"task-orchestrator/tasks/{task}/claim", by="Anna", override=True)
    product.post(f"task-orchestrator/tasks/{task}/comments", by="Ben", text="Use the new scale.")
    with product.page(f"/tasks?task={task.rpartition(':')[2]}") as page:
        page.get_by_role("form", name="Result").wait_for()
        page.get_by_label("Weight (kg) (required)").fill("12.5")
        time.sleep(2)
        product.keep(page, "tasks")


def cockpit(product: Product) -> None:
    """The heat map of a definition with completed and running processes."""
    for _ in range(3):
        product.complete(product.start_process())
    running = product.start_process()
    with product.page("/cockpit?of=bin-picking") as page:
        page.locator(".diagram__badge--duration").first.wait_for()
        time.sleep(3)
        product.keep(page, "cockpit")
    product.complete(running)


def system(product: Product) -> None:
    """The robot in 3D while it picks a part."""
    process = product.start_process()
    with product.page("/system?tab=robots") as page:
        page.locator("canvas").first.wait_for()

        def is_picking() -> bool:
            product.answer()
            robot = product.http.get("/trajectory-tool/robots/ur10-1").json()
            return robot["operation"] == "pick" and robot["progress"] > 0.3

        wait_until(is_picking)
        page.screenshot(path=product.out / "system.png")
    product.complete(process)


def calibrate(product: Product) -> None:
    """The live signal with its thresholds."""
    with product.page("/calibrate?glove=glove-1&finger=index") as page:
        page.get_by_role("img", name="Signal of the index finger").wait_for()
        for code in ("02222", "00000", "20222", "22222", "00000", "20022") * 5:
            product.hand.show(code)
            time.sleep(1.1)
        product.keep(page, "calibrate")
    product.hand.show("00000")


def devices(product: Product) -> None:
    """Rooms with the values of simulated devices, one of which is away, and a robot with its history."""
    rooms = ("Hall A", "Hall B", "Kitchen")
    played: list[SimulatedDevice] = []
    try:
        for number, (name, description) in enumerate(examples().items()):
            body = description.model_dump(mode="json", by_alias=True)
            body["placement"] = {"location": rooms[number % len(rooms)]}
            made = product.post("/device-gateway/devices", name=name, description=body)
            client = DeviceClient("127.0.0.1", made["port"], name, made["token"])
            device = SimulatedDevice(client, DeviceDescription.model_validate(body))
            if name != "sim-camera":
                device.start()
                played.append(device)
            earlier = range(-170, 0)
            if name in {"sim-sensor", "sim-actuator", "sim-panda"}:
                for step in earlier:
                    now_s = time.time() + 10 * step
                    client.send(device.values_at(now_s), now_s)
        wait_until(lambda: not any(device.client.waiting() for device in played))
        with product.page("/sensors", viewport=TALL) as page:
            page.get_by_role("article", name="sim-panda").wait_for()
            time.sleep(3)
            product.keep(page, "sensors")
        with product.page("/devices?device=sim-panda&part=history&values=externalForce,gripperWidth") as page:
            page.get_by_role("img", name="External force").wait_for()
            time.sleep(2)
            product.keep(page, "devices")
    finally:
        for device in played:
            device.stop()


def people(product: Product) -> None:
    """A person with gestures of one hand, of both hands, and in sequence."""
    controller = product.http
    person = "/gesture-controller/people/anna"
    controller.put(person, json={"title": "Anna K."}).raise_for_status()
    controller.put("/gesture-controller/people/ville", json={"title": "Ville M."}).raise_for_status()
    for name, how in (
        ("Both thumbs", {"left": "Thumbs up", "right": "Thumbs up"}),
        ("Point, then horns", {"sequence": ["Point with index", "Horns"]}),
    ):
        controller.put(f"{person}/gestures/{name}", json=how).raise_for_status()
    controller.patch(
        f"{person}/commands", json={"3": "Both thumbs", "5": "Point, then horns"}
    ).raise_for_status()
    controller.put("/gesture-controller/gloves/glove-1/person", json={"person": "anna"}).raise_for_status()
    with product.page("/people?person=anna") as page:
        page.get_by_role("heading", name="Anna K.").wait_for()
        time.sleep(1)
        product.keep(page, "people")
    controller.put("/gesture-controller/gloves/glove-1/person", json={"person": None}).raise_for_status()


def test(product: Product) -> None:
    """The report of an accuracy test with some wrong gestures."""
    gestures = ["Thumbs up", "Horns", "Point with index", "Thumb and index straight", "Ring straight"]
    began = product.post(
        "/gesture-controller/tests", glove="glove-1", gestures=gestures, rounds=2, breaks=False
    )
    trials = 0
    previous = None
    while (run := product.glove().get("accuracyTest")) is not None:
        asked = run["asked"]
        if asked is not None and (asked["gesture"], run["done"]) != previous:
            previous = (asked["gesture"], run["done"])
            trials += 1
        wrong = asked is not None and trials in {3, 8} and run["askedForMs"] < 2500
        product.hand.show("00000" if asked is None else "20022" if wrong else asked["code"])
        time.sleep(0.1)
    product.hand.show("00000")
    with product.page(f"/test?part=accuracy&test={began['id']}", viewport=TALL) as page:
        page.get_by_role("heading", name="Confusion matrix").wait_for()
        product.keep(page, "test")


def study(product: Product) -> None:
    """The results of a study with twelve invented participants."""
    invented = random.Random(3)
    for _ in range(12):
        session = product.post("/study/sessions", language="en")
        path = f"/study/sessions/{session['id']}"
        while session["step"] != "finished":
            session = product.http.get(path).json()
            if session["step"] != "finished":
                content = study_answer(session, invented)
                product.http.post(f"{path}/steps/{session['step']}", json=content).raise_for_status()
    with product.page("/study") as page:
        page.get_by_text("Mean").first.wait_for()
        product.keep(page, "study")


class Patient:
    """A person who sits in front of the humanoid, looks at the ball, and holds a hand where it lands."""

    def __init__(self, url: str) -> None:
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(url,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take the headset off."""
        self._ended.set()
        self._thread.join()

    def _run(self, url: str) -> None:
        with (
            connect(f"{url}/live?hz=60", proxy=None, ping_interval=None) as live,
            connect(f"{url}/input?role=patient", proxy=None, ping_interval=None) as sent,
        ):
            while not self._ended.is_set():
                sent.send(orjson.dumps(_pose(orjson.loads(live.recv(timeout=60)))).decode())
                while orjson.loads(sent.recv(timeout=60))["kind"] == "haptic":
                    pass  # the answer to the pose comes after it


def _pose(state: dict[str, Any]) -> dict[str, Any]:
    x, y = (state["base"] or (0.0, 0.0))[:2]
    ball = state["ball"] or {}
    head = (x + 1.15, y, 1.15)
    place = ball.get("target") or (x + 0.8, y + 0.15, 0.6)
    is_seen = ball.get("phase") in {"held", "flying"}
    seen = (ball["position"] if is_seen else None) or (x, y, 0.6)
    ahead, left, up = (there - here for there, here in zip(seen, head, strict=True))
    yaw, pitch = math.atan2(left, ahead) / 2, -math.atan2(up, math.hypot(ahead, left)) / 2
    turn = (
        -math.sin(yaw) * math.sin(pitch),
        math.cos(yaw) * math.sin(pitch),
        math.sin(yaw) * math.cos(pitch),
        math.cos(yaw) * math.cos(pitch),
    )
    return {
        "kind": "pose",
        "t": time.monotonic(),
        "headset": {"position": head, "rotation": turn},
        "hands": {
            "right": {"position": place, "grip": 0.0},
            "left": {"position": (x + 0.85, y - 0.2, 0.7), "grip": 0.0},
        },
    }


def humanoid(product: Product) -> None:
    """The humanoid during a session: a ball flies to a person who has caught one already."""
    service = "/whole-body-control"

    def state() -> dict[str, Any]:
        return dict(product.http.get(f"{service}/state").raise_for_status().json())

    wait_until(lambda: state()["fault"] is None and state()["phase"] == "standing")
    patient = Patient(product.humanoid)
    try:
        wait_until(lambda: state()["patient"] is not None)
        session = product.post(f"{service}/sessions", application="juggling", goal={"throws": 10})["id"]
        with product.page("/humanoid") as page:
            page.get_by_role("application").wait_for()

            def is_thrown() -> bool:
                now = state()
                if now["session"]["state"] == "paused":  # poses came late beside other work
                    product.http.post(f"{service}/sessions/{session}/resume")
                has_caught = now["session"]["caught"] > 0
                return bool(has_caught and (now["ball"] or {}).get("phase") == "flying")

            wait_until(is_thrown, 240.0)
            page.screenshot(path=product.out / "humanoid.png")
        product.post(f"{service}/sessions/{session}/end")
    finally:
        patient.close()


def health(product: Product) -> None:
    """A person with a simulated belt and mat, who rests and then works, and whose heart limits the robot."""
    service, person = "/human-state", "aino"
    product.http.put(f"{service}/people/{person}", json={"age": 40}).raise_for_status()
    consent = {
        "purposes": ["live", "speedLimits", "history"],
        "ends": iso(datetime.now(UTC) + timedelta(days=200)),
        "givenBy": "Aino",
    }
    product.http.put(f"{service}/people/{person}/consent", json=consent).raise_for_status()
    product.http.put(f"{service}/people/{person}/robots/ur10-1").raise_for_status()
    settings = {
        "signals": ["ecg", "respiration", "acceleration", "pressureMap", "heartRate"],
        "program": [{"at_s": 0, "posture": "sitting"}, {"at_s": 15, "effort": 0.6, "posture": "standing"}],
    }
    sensor = {"person": person, "driver": "simulated", "settings": settings}
    product.http.put(f"{service}/sensors/belt-1", json=sensor).raise_for_status()

    def works() -> bool:
        state = product.http.get(f"{service}/people/{person}/state").raise_for_status().json()
        rates = [
            state_value["value"] for state_value in state["values"] if state_value["name"] == "heartRate"
        ]
        return bool(rates and rates[0] > WORKING_BPM)

    wait_until(works, 180.0)
    with product.page(f"/health?person={person}", viewport=TALL) as page:
        page.locator(".vital-sign[data-trust=valid]").first.wait_for()
        page.get_by_role("img", name="ECG, the last 10 s").locator("canvas").wait_for()
        time.sleep(12)  # waveforms fill their width
        product.keep(page, "health")
    product.http.delete(f"{service}/people/{person}").raise_for_status()


def study_answer(session: dict[str, Any], invented: random.Random) -> dict[str, Any]:
    """Return an invented answer to the current step."""
    step = session["step"]
    if step == "consent":
        return {"agreed": True, "text": session["consentVersion"]}
    if step == "sus":
        return {
            "answers": [
                invented.randint(3, 5) if nth % 2 == 0 else invented.randint(1, 3) for nth in range(10)
            ]
        }
    if step.startswith("tlx"):
        middle = 30 if session["condition"] == "personal" else 45
        scales = sorted({scale for pair in session["pairs"] for scale in pair})
        ratings = {scale: 5 * round(min(max(invented.gauss(middle, 15), 0), 100) / 5) for scale in scales}
        choices = [{"of": pair, "chosen": invented.choice(pair)} for pair in session["pairs"]]
        return {"ratings": ratings, "choices": choices}
    if step == "preference":
        return {"preferred": invented.choice(["personal", "personal", "predefined"])}
    return {}


def all_looks(product: Product, folder: Path) -> None:
    """Every page in every size; both themes and all languages on the laptop, the others in turn."""
    folder.mkdir(parents=True, exist_ok=True)
    process = product.start_process()
    product.prompted_code()
    variants = [("laptop", "en", "light"), ("laptop", "de", "dark"), ("laptop", "fi", "light")]
    variants += [("phone", "de", "light"), ("tablet", "fi", "dark"), ("4k", "en", "dark")]
    for size, language, theme in variants:
        with product.page("/", language=language, theme=theme, viewport=LOOKS[size]) as page:
            for name, path in PAGES.items():
                page.goto(path)
                time.sleep(1.5)
                page.screenshot(path=folder / f"{name}-{size}-{language}-{theme}.png")
    product.complete(process)


SCENES = {"people": people, "devices": devices, "work": work, "processes": processes, "tasks": tasks,
          "cockpit": cockpit, "system": system, "calibrate": calibrate, "test": test,
          "humanoid": humanoid, "health": health, "study": study}  # fmt: skip


def main() -> None:
    """Make the pictures that the arguments name."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(SCENES), help="names of pictures, separated by commas")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--all-looks", type=Path)
    arguments = parser.parse_args()
    chromium = installed_chromium()
    arguments.out.mkdir(parents=True, exist_ok=True)
    # Otherwise the services would outlive a script that `timeout` terminates.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        (whole_body,) = free_ports(1)
        env = {
            **environment(folder),
            "HANDOVER_ANNOUNCE_MS": "500",
            "HANDOVER_CONFIRM_MS": "1500",
            "HANDOVER_WHOLE_BODY_PORT": str(whole_body),
            "HANDOVER_HUMANOID_PORTS_DIR": f"{folder}/ports",
        }
        if "humanoid" in arguments.only or arguments.all_looks is not None:
            env["HANDOVER_HUMANOID_MODEL"] = "coman"
        services, _ = up(env)
        try:
            browser = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
            product = Product(env, browser, arguments.out)
            for name in filter(None, arguments.only.split(",")):
                SCENES[name](product)
                print(f"{name} done", flush=True)
            if arguments.all_looks is not None:
                all_looks(product, arguments.all_looks)
            product.hand.close()
            browser.close()
        finally:
            stop(services)


if __name__ == "__main__":
    main()
