"""A server of the public chat-completions protocol, like those of language models: good ones and bad ones."""

import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


def completion(text: Any) -> bytes:
    choice = {"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}
    return json.dumps({"id": "c-1", "object": "chat.completion", "model": "m", "choices": [choice]}).encode()


@dataclass
class Completions:
    """What the server answers, and what it was asked. `hangs` waits until `released`, without an answer."""

    answer: Callable[[dict[str, Any]], str] = lambda _: "Keep this pace."
    status: int = 200
    raw: bytes | None = None
    location: str = ""
    hangs: bool = False
    released: threading.Event = field(default_factory=threading.Event)
    bodies: list[dict[str, Any]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    url: str = ""


@contextmanager
def serving(state: Completions) -> Iterator[Completions]:
    """Serve until the block ends."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            state.bodies.append(body)
            state.headers.append(dict(self.headers))
            state.paths.append(self.path)
            if state.hangs:
                state.released.wait(60)
                return
            content = completion(state.answer(body)) if state.raw is None else state.raw
            self.send_response(state.status)
            if state.location:
                self.send_header("Location", state.location)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    state.url = f"http://127.0.0.1:{server.server_port}/v1"
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield state
    finally:
        state.released.set()
        server.shutdown()
        server.server_close()
        thread.join()


def obedient(body: dict[str, Any]) -> str:
    """Answer as a model that does what it is asked, in the language that it is asked for."""
    task = body["messages"][-1]["content"]
    advice = "faster" if "faster" in task else "slower" if "slower" in task else "keep"
    language = next(name for name in ("English", "German", "Finnish") if name in task)
    return {
        ("faster", "English"): "Lovely stride! Let's go just a little faster.",
        ("keep", "English"): "Perfect, keep exactly this rhythm.",
        ("slower", "English"): "Take it a touch slower and enjoy it.",
        ("faster", "German"): "Sehr schön, gehen Sie etwas schneller!",
        ("keep", "German"): "Prima, bleiben Sie bei diesem Tempo.",
        ("slower", "German"): "Gehen Sie jetzt etwas langsamer.",
        ("faster", "Finnish"): "Hienoa, kävele hieman nopeammin!",
        ("keep", "Finnish"): "Hyvä, pidä tämä vauhti.",
        ("slower", "Finnish"): "Kävele nyt hieman hitaammin.",
    }[advice, language]


def nonsense(body: dict[str, Any]) -> str:
    """Answer as a model that does not do what it is asked."""
    return "Your heart rate is 182, stop at once!" if "faster" in str(body) else "Banana."


def main() -> None:
    """Serve as a process: print the URL, and each request as a line of JSON, until the input ends."""
    answers = {"obedient": obedient, "nonsense": nonsense, "hangs": obedient}
    given = sys.argv[1]

    def answer(body: dict[str, Any]) -> str:
        print(json.dumps({"body": body, "headers": state.headers[-1], "path": state.paths[-1]}), flush=True)
        return answers[given](body)

    state = Completions(answer)
    with serving(state):
        print(state.url, flush=True)
        if given == "hangs":
            state.answer = lambda body: (answer(body), state.released.wait(60))[0]
        sys.stdin.read()


if __name__ == "__main__":
    main()
