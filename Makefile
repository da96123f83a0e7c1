# make demo: from nothing to a table of how well two methods localise an ROV over a rendered reef.
# make test: the tests, the linter and the type checker. make test-slow: the tests that take minutes, too.
# make hub KEY=my-hub.pem: the minis, and the weights that were trained here, as a published tree to attach to a release.
# make docs: the documentation site in build/docs, without a warning and without a dead link.
# make coverage: the tests, and how much of the code they run; the lines that they do not are in build/coverage/.

PYTHON ?= python3
VENV ?= .venv
# Images of containers often forbid it: then every process compiles all that it imports anew, seconds of each.
export PYTHONDONTWRITEBYTECODE :=
INSTALL = $(VENV)/bin/python .ci/install.py
PINS = pyproject.toml .ci/constraints.txt .ci/install.py

.PHONY: hub demo test unit kernels test-slow docs coverage lint clean

demo: $(VENV)/.demo
	$(VENV)/bin/oysterbench eval --track slam

HERE = import json, sys; print(*(one["model"] for one in json.load(sys.stdin)["models"] if one["file"]))

hub: $(VENV)/.dev
	@test -f "$(KEY)" || { echo "make hub KEY=FILE: expected a private key; '$(VENV)/bin/oysterbench keygen FILE' makes one"; exit 2; }
	for split in slam-mini seg-mini steer-mini; do $(VENV)/bin/oysterbench render $$split && \
		$(VENV)/bin/oysterbench publish $$split build/hub --key "$(KEY)" || exit; done
	for model in $$($(VENV)/bin/oysterbench models --json | $(VENV)/bin/python -c '$(HERE)'); do \
		$(VENV)/bin/oysterbench publish-model $$model build/hub --key "$(KEY)" || exit; done
	tar --create --file build/hub.tar --sort name --exclude .lock --directory build hub
	$(VENV)/bin/oysterbench verify build/hub > build/hub.txt && ls -l build/hub.tar

test: $(VENV)/.dev # the type checker has one core's work for a minute or two, beside which kernels compile and tests begin
	$(MAKE) --no-print-directory --jobs 2 lint unit

unit: kernels
	$(VENV)/bin/pytest -n auto --dist loadfile

kernels: $(VENV)/.dev # once, before several processes of the tests do so side by side
	$(VENV)/bin/python -m tests.helpers.compile_kernels

test-slow: kernels
	$(VENV)/bin/pytest -m "slow or not slow"

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict --quiet
	$(VENV)/bin/python -m docs.check build/docs

coverage: $(VENV)/.dev
	$(VENV)/bin/pytest -n auto --dist loadfile --cov --cov-report term:skip-covered --cov-report html:build/coverage

lint: $(VENV)/.dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

$(VENV)/bin/pip:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: $(VENV)/bin/pip $(PINS)
	@echo "installing oysterbench and what the demo needs into $(VENV)"
	$(INSTALL) ".[render,slam]"
	@touch $@

$(VENV)/.dev: $(VENV)/bin/pip $(PINS)
	@echo "installing oysterbench and what the tests need into $(VENV)"
	$(INSTALL) ".[dev]"
	@touch $@

$(VENV)/.docs: $(VENV)/bin/pip $(PINS)
	@echo "installing oysterbench and what the site needs into $(VENV)"
	$(INSTALL) ".[docs]"
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info
