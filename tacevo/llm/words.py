"""The error of a server: its words, and the status that a code in it stands for; pure.

Servers, and routers before them, give an error any status, also 200, and say in the body what is meant. So a code there
decides as a status would, unless the status itself says exactly what is wrong.
"""

import re
from collections.abc import Iterator, Mapping

from tacevo.records import Json

#: Statuses that pass: time-out, conflict of locks, a broken generation, rate limit, a closed connection.
PASSING = frozenset({408, 409, 424, 425, 429, 499})

#: Statuses that need no code beside them.
_EXACT = frozenset({401, 402, 404, 413}) | PASSING

#: The fields of an error that hold its words; what else stands there may repeat the request.
_WORDS = (
    *("loc", "message", "msg", "detail", "title", "error", "errors", "code", "type", "status", "innererror"),
    *("metadata", "raw", "base_resp", "status_msg"),
)

#: The fields that hold a code, and those that hold an error within an error.
_CODES = ("code", "status", "status_code", "statusCode", "http_status", "type")
_WITHIN = ("error", "errors", "detail", "innererror", "base_resp")

#: The statuses that words in the place of a code stand for, without case and signs.
_STATUSES = {
    **dict.fromkeys(["authenticationerror", "invalidapikey", "incorrectapikey"], 401),
    **dict.fromkeys(["unauthorized", "unauthorizederror", "unauthenticated"], 401),
    **dict.fromkeys(["billingerror", "insufficientquota", "insufficientbalance", "insufficientcredits"], 402),
    **dict.fromkeys(["paymentrequired"], 402),
    **dict.fromkeys(["permissionerror", "permissiondenied", "permissiondeniederror", "forbidden"], 403),
    **dict.fromkeys(["notfounderror", "notfound", "modelnotfound", "modelnotfounderror", "modelnotsupported"], 404),
    **dict.fromkeys(["requesttoolarge", "payloadtoolarge"], 413),
    **dict.fromkeys(["ratelimiterror", "ratelimitexceeded", "ratelimitreached", "toomanyrequests"], 429),
    **dict.fromkeys(["resourceexhausted", "throttlingexception"], 429),
    **dict.fromkeys(["apierror", "servererror", "internalservererror", "internalerror", "internal"], 500),
    **dict.fromkeys(["overloadederror", "overloaded", "serviceunavailable", "serviceunavailableerror"], 503),
    **dict.fromkeys(["unavailable", "engineoverloadederror"], 503),
    **dict.fromkeys(["timeout", "timeouterror", "deadlineexceeded", "gatewaytimeout"], 504),
}

#: Such words for a refusal of the request. Errors of all kinds have them, so they count where the status says nothing.
_INVALID = frozenset(
    {"invalidrequesterror", "badrequesterror", "badrequest", "invalidargument", "invalidrequest", "validationerror"}
)

#: The words by which servers say that there is no money or no account, some with a status that would otherwise blame
#: the request.
_NO_MONEY = re.compile(
    r"insufficient[ _](quota|balance|credits?|funds)|exceeded_current_quota|arrear|account is (not )?in good standing"
    r"|account\b[^.]{0,80}\bis suspended|余额不足|欠费",
    re.IGNORECASE,
)
_PAYMENT = re.compile(
    r"credit balance|billing[ _](details|error)|(spend|spending|usage) limit"
    r"|organi[sz]ation has been disabled|account (has been|was|is) (disabled|deactivated|suspended|terminated)",
    re.IGNORECASE,
)

#: The words by which servers say that the key is wrong, and that there is no such model, where the status says neither.
_WRONG_KEY = re.compile(
    r"\b(invalid|incorrect|wrong|missing|expired|revoked)\b[^.]{0,20}\b(api[ _-]?key|credentials?|access token)\b"
    r"|\b(api[ _-]?key|credentials?)\b[^.]{0,30}\b(not valid|invalid|incorrect|expired|missing|not found|revoked)"
    r"|\bnot authenticated\b|\bauthentication error\b|\blogin fail",
    re.IGNORECASE,
)
_NO_MODEL = re.compile(
    r"\bmodel\b[^.]{0,80}\b(not found|(does|do) not exist)|\b(unknown|no such) model\b|not a valid model\b",
    re.IGNORECASE,
)

#: The words by which servers say that a request does not fit into a model: whatever the status, and where that blames
#: the request.
_CONTEXT = re.compile(
    r"(context[ _]?(length|window|size|limit).{0,80}(exceed|limit|maxim|longer|larger|greater|too |overflow|reduce)"
    r"|(exceed|maxim|longer than|larger than|greater than|too (long|large|many)).{0,80}context[ _]?(length|window|size)"
    r"|maximum context|max_model_len|max(imum)? (model|input|prompt|sequence) len(gth)?"
    r"|\b(prompt|inputs?|messages?|conversation|text)( \w+)? (is|are|was|were) too (long|large)"
    r"|\b(prompt|input)[ _]too[ _]long|string_above_max_length|input token count|input is too (long|large)"
    r"|longer than the model|(less than|at most|<=) \d+ tokens|range of input length"
    r"|\b(prompt|input)s?\b.{0,40}(length|tokens?|count)\b.{0,40}(exceed|more than|larger than|longer than|must be)"
    r"|exceed\w* (the )?(maximum|max|limit|model|allowed)[^.]{0,30}\b(length|tokens?)\b)",
    re.IGNORECASE | re.DOTALL,
)
_TOO_LONG = re.compile(r"too (long|large)\b|context[ _]?(length|window|size)|too many (input |prompt )?tokens", re.I)

#: The words by which servers say that they will not answer a request because of what it is about.
_FILTERED = re.compile(
    r"content[ _-]?(filter|policy|management policy|moderation|violation)|ResponsibleAIPolicy|prohibited[ _]content"
    r"|\b(inputs?|prompts?|requests?|quer(y|ies)|messages?|contents?|texts?|outputs?|responses?|completions?|answers?)\b"
    r"[^.]{0,40}\b(flagged|blocked|filtered|moderated|censored|violat\w+|prohibited|inappropriate|sensitive|unsafe)\b"
    r"|\b(flagged|blocked|rejected|refused|filtered) (by|due to|as|because of|for)\b[^.]{0,60}"
    r"(safety|moderat|polic|filter|content|guardrail|violat|sensitiv|harm|inappropriate|unsafe)"
    r"|safety[ _](system|filter|setting|polic|guideline|reason|violation)|guardrail|\bmoderation\b"
    r"|(usage|acceptable use|safety) polic|data[ _]?inspection[ _]?failed|(put|new)[ _]sensitive\b"
    r"|sensitive[ _](content|information|words?)",
    re.IGNORECASE,
)
#: The words among these that no word about an account beside them puts in doubt.
_CERTAINLY_FILTERED = re.compile(r"\bcontents? violat|safety[ _]check|usage guidelines", re.IGNORECASE)

#: The words by which they say that it is a rate, or not the request, that is forbidden, and that something will pass.
_RATE = re.compile(r"\bper (second|minute|hour|day|month)\b|\b[tr]p[md]\b", re.IGNORECASE)
_ACCOUNT = re.compile(
    r"\b(account|organi[sz]ation|api[ _-]?key|subscription|project|workspace|region|country|permission|ip address)\b",
    re.IGNORECASE,
)
_TRANSIENT = re.compile(
    r"\b(later|shortly|in a (moment|minute|few))\b|please retry|temporar|unavailable|timed?[ -]?out|overload|\bbusy\b"
    r"|capacity|too many requests|rate.?limit|throttl",
    re.IGNORECASE,
)

#: The words by which servers say that a model has no system prompt.
_NO_SYSTEM = re.compile(r"\bsystem\b|roles? must alternate|\bonly user\b|developer instruction", re.IGNORECASE)


def error_in(value: Json) -> Json:
    """Return what stands as the error of a body or of a part of it; None where nothing does: some servers send `{}`."""
    error = value.get("error") if isinstance(value, Mapping) else None
    says_something = any(error.values()) if isinstance(error, Mapping) else error
    return error if says_something else None


def words_of(body: Json) -> str:
    """Return a server's own words, or what stands for them, in one line."""
    return " ".join(_texts(body).split()) or "no explanation"


def decisive_status(status: int, body: Json) -> int:
    """Return the status that says what follows from an error: the one that came, or that of a code in its body.

    Where both say little, the words may still tell of a wrong key or an unknown model.

    Args:
        status: as it came; 200 for an error within what should be an answer.
        body: the parsed JSON, or the text where it is none.
    """
    coded = status if status in _EXACT else _coded(status, body)
    said = words_of(body)
    if coded in _EXACT or coded == 403 or _TRANSIENT.search(said):
        return coded
    return 401 if _WRONG_KEY.search(said) else 404 if _NO_MODEL.search(said) else coded


def _coded(status: int, body: Json) -> int:
    """Return the status of a code in a body, or else the one that came."""
    codes = list(_codes(body))
    for code in codes:
        is_status = isinstance(code, int) or (len(code) == 3 and code.isdecimal())
        if is_status and 400 <= int(code) < 600:
            return int(code)
    folded = [re.sub("[^a-z]", "", code.casefold()) for code in codes if isinstance(code, str)]
    for word in folded:
        if word in _STATUSES:
            return _STATUSES[word]
    is_unsaid = status < 400 or status >= 500
    return 400 if is_unsaid and any(word in _INVALID for word in folded) else status


def lacks_money(status: int, said: str) -> bool:
    """Answer whether an error is about money, or an account that is closed."""
    return status == 402 or bool(_NO_MONEY.search(said)) or (status not in PASSING and bool(_PAYMENT.search(said)))


def is_about_request(status: int, said: str) -> bool:
    """Answer whether an error says of one request that it can never be answered: it is too long, or filtered."""
    if status in _EXACT:
        return status == 413
    is_refusal = 400 <= status < 500
    if not is_refusal and _TRANSIENT.search(said):
        return False
    is_of_account = status == 403 and _ACCOUNT.search(said) and not _CERTAINLY_FILTERED.search(said)
    if _RATE.search(said) or is_of_account:
        return False
    return bool(_CONTEXT.search(said) or _FILTERED.search(said)) or (is_refusal and bool(_TOO_LONG.search(said)))


def is_filtered(said: str) -> bool:
    """Answer whether a request was refused because of what it is about."""
    return _FILTERED.search(said) is not None


def wants_no_system_prompt(said: str) -> bool:
    """Answer whether a refusal may say that the model has no system prompt."""
    return _NO_SYSTEM.search(said) is not None


def _texts(value: Json, depth: int = 6) -> str:
    """Join the texts of an error: `{"error": {"message": ...}}`, FastAPI's `detail` with its place, a text.

    What a server repeats of a request is left out: a setting that stands there is not refused.
    """
    if isinstance(value, str) or depth == 0:
        return value if isinstance(value, str) else ""
    if isinstance(value, Mapping):
        value = [value.get(name) for name in _WORDS]
    if not isinstance(value, list):
        return ""
    return " ".join(filter(None, (_texts(part, depth - 1) for part in value)))


def _codes(value: Json, depth: int = 6) -> Iterator[int | str]:
    """Yield what stands in the place of a code, the outermost first."""
    if depth == 0:
        return
    if isinstance(value, list):
        for part in value:
            yield from _codes(part, depth - 1)
    elif isinstance(value, Mapping):
        for name in _CODES:
            if isinstance(code := value.get(name), int | str) and not isinstance(code, bool):
                yield code
        for name in _WITHIN:
            yield from _codes(value.get(name), depth - 1)
