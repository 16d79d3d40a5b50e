"""A scripted learner: it answers requests with prepared replies."""

from __future__ import annotations

import threading

from samples import RUN, settings

from common.wire.messages import JoinReply
from common.wire.session import Request, Session
from services.worker.joining import Assignment, join


class Script:
    """Answers what is asked on a key with the next of its answers, and keeps what was asked.

    None is an answer that never comes: the request is kept open.
    """

    def __init__(self, *answers: bytes | None) -> None:
        self.answers = list(answers)
        self.asked: list[bytes] = []
        self.open: list[Request] = []

    def __call__(self, request: Request) -> None:
        self.asked.append(request.payload)
        answer = self.answers.pop(0)
        if answer is None:
            self.open.append(request)
        else:
            request.reply(answer)


def reply(accepted: bool, text: str = "", *, slug: str = "no_slot", final: bool = False) -> bytes:
    if not accepted:
        return JoinReply.refused(RUN, slug, text, final=final).encode()
    return JoinReply.granted(RUN, 1, 2, settings(seed=7).model_dump_json()).encode()


def ask_to_join(session: Session, stop: threading.Event, told: list[str] | None = None) -> Assignment | None:
    heard = [] if told is None else told
    return join(session, run=RUN, physics="native", versions={}, hardware={}, stop=stop, waiting=heard.append)
