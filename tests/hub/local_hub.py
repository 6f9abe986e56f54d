"""A small Hugging Face Hub over real HTTP, as far as pushing and loading policies and datasets needs one."""

import base64
import hashlib
import json
import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote

COMMIT = "1" * 40
_API = r"/api/(?:models|datasets)/([^/]+/[^/]+)"


class LocalHub:
    """Serves while it is entered; the files of a repository are at `root/<user>/<name>`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.tags: dict[str, list[str]] = {}
        self.head = COMMIT  # of every repository; whatever revision is asked for, this is what is there
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"hub": self}))

    @property
    def url(self) -> str:
        """For HF_ENDPOINT."""
        return f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> "LocalHub":
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def files(self, repo: str) -> dict[str, Path]:
        """Files of a repository by their path in it."""
        folder = self.root / repo
        return {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}

    def commit(self, repo: str, lines: bytes) -> None:
        """Store what a commit adds: lines of JSON, contents in base64."""
        for entry in map(json.loads, lines.splitlines()):
            if entry["key"] == "file":
                path = self.root / repo / entry["value"]["path"]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(base64.b64decode(entry["value"]["content"]))


class _Handler(BaseHTTPRequestHandler):
    hub: LocalHub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        """Keep quiet."""

    def do_POST(self) -> None:
        body, path = self._body(), self.path.split("?")[0]
        if path == "/api/repos/create":
            asked = json.loads(body)
            repo = "/".join(filter(None, (asked.get("organization"), asked["name"])))
            (self.hub.root / repo).mkdir(parents=True, exist_ok=True)
            self._json({"url": f"{self.hub.url}/{repo}", "name": repo, "id": repo})
        elif path == "/api/validate-yaml":
            self._json({"errors": [], "warnings": []})
        elif re.fullmatch(rf"{_API}/preupload/main", path):
            files = [{"path": file["path"], "uploadMode": "regular"} for file in json.loads(body)["files"]]
            self._json({"files": [{**file, "shouldIgnore": False} for file in files]})
        elif found := re.fullmatch(rf"{_API}/commit/main", path):
            self.hub.commit(found[1], body)
            self._json({"commitOid": self.hub.head, "commitUrl": f"{self.hub.url}/{found[1]}/commit/{self.hub.head}"})
        elif found := re.fullmatch(rf"{_API}/tag/main", path):
            self.hub.tags.setdefault(found[1], []).append(json.loads(body)["tag"])
            self._json({})
        else:
            self._answer(404, b"", {})

    def do_GET(self) -> None:
        path = self.path.split("?")[0]
        if found := re.fullmatch(r"(?:/datasets)?/([^/]+/[^/]+)/resolve/[^/]+/(.+)", path):
            self._file(self.hub.root / found[1] / unquote(found[2]))
        elif found := re.fullmatch(rf"{_API}/refs", path):
            self._json({"converts": [], "branches": [self._reference("heads/main")], "tags": self._tags(found[1])})
        elif found := re.fullmatch(rf"{_API}/tree/[^/]+", path):
            self._json(
                [{"type": "file", "path": name, **self._size(file)} for name, file in self.hub.files(found[1]).items()]
            )
        elif found := re.fullmatch(rf"{_API}(?:/revision/[^/]+)?", path):
            siblings = [{"rfilename": name} for name in self.hub.files(found[1])]
            self._json({"id": found[1], "sha": self.hub.head, "private": False, "tags": [], "siblings": siblings})
        else:
            self._answer(404, b"", {})

    do_HEAD = do_GET

    def _tags(self, repo: str) -> list[dict[str, str]]:
        return [self._reference(f"tags/{tag}") for tag in self.hub.tags.get(repo, [])]

    def _reference(self, name: str) -> dict[str, str]:
        return {"name": name.split("/")[1], "ref": f"refs/{name}", "targetCommit": self.hub.head}

    @staticmethod
    def _size(file: Path) -> dict[str, Any]:
        return {"size": file.stat().st_size, "oid": hashlib.sha1(file.read_bytes()).hexdigest()}

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length", 0)))
        chunks = []
        while size := int(self.rfile.readline(), 16):
            chunks.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(chunks)

    def _file(self, path: Path) -> None:
        if not path.is_file():
            self._answer(404, b"", {"X-Error-Code": "EntryNotFound", "X-Repo-Commit": self.hub.head})
            return
        content = path.read_bytes()
        self._answer(200, content, {"ETag": f'"{hashlib.sha1(content).hexdigest()}"', "X-Repo-Commit": self.hub.head})

    def _json(self, answer: dict[str, Any]) -> None:
        self._answer(200, json.dumps(answer).encode(), {"Content-Type": "application/json"})

    def _answer(self, status: int, content: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
