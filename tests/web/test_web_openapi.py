"""The promises of OpenAPI, tried with what its schemas allow and do not allow."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable

schemathesis = pytest.importorskip("schemathesis", reason="schemathesis is missing")

from schemathesis.checks import not_a_server_error  # noqa: E402
from schemathesis.specs.openapi.checks import (  # noqa: E402
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

HEADERS = {"Authorization": "Bearer token"}
# These addresses take seconds; other tests try them.
SLOW_BY_NATURE = ("/api/baseline", "/api/zero", "/api/learn")
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]


@pytest.fixture(scope="module")
def api_schema(make_session, connected):
    with connected(make_session(), rate_hz=10_000) as client:
        yield schemathesis.openapi.from_url(
            f"{client.base_url}/openapi.json", headers=HEADERS
        )


@pytest.mark.parametrize("mode", ["positive", "negative"])
@pytest.mark.slow
def test_every_answer_is_one_that_was_promised(api_schema, mode):
    tried = set()
    for result in api_schema.get_all_operations():
        operation = result.ok()
        if operation.path in SLOW_BY_NATURE:
            continue
        tried.add(operation.path)
        _try(operation, schemathesis.GenerationMode(mode))
    assert len(tried) > 15


def test_openapi_says_how_the_token_is_sent(api_schema):
    schema = api_schema.raw_schema
    ((name, scheme),) = schema["components"]["securitySchemes"].items()
    assert (scheme["type"], scheme["scheme"]) == ("http", "bearer")
    for path in schema["paths"].values():
        assert all(operation["security"] == [{name: []}] for operation in path.values())


def test_a_deprecated_address_says_which_one_to_use(api_schema):
    paths = api_schema.raw_schema["paths"]
    old, new = paths["/api/zero"]["post"], paths["/api/baseline"]["post"]
    assert old["deprecated"]
    assert "Use /api/baseline" in old["description"]
    assert "deprecated" not in new
    for part in ("requestBody", "responses"):
        assert old[part] == new[part]


def _try(operation, mode):
    """Call one operation with what its schema allows, or does not allow."""

    @settings(
        max_examples=3,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def call(case):
        case.call_and_validate(headers=HEADERS, checks=CHECKS)

    try:
        call()
    except Unsatisfiable:  # some operations take nothing that could be wrong
        assert mode is schemathesis.GenerationMode.NEGATIVE
