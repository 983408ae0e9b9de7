# `make demo` and `make test` do all the set-up themselves: they build .venv when it is missing or stale.
PYTHON ?= python3
VENV := .venv
STAMP := $(VENV)/.installed
BIN := $(VENV)/bin

.PHONY: help demo test test-slow lint docs bench results lerobot clean

help: ## show this
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

demo: $(STAMP) ## from nothing to a robot moving bags, and a report: minutes on two cores
	$(BIN)/python examples/demo.py

# What tests of one file share is made once. Two processes have two cores: threads of theirs would only wait.
test: $(STAMP) browser ## the fast tests, 4 to 8 minutes on two cores
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile

test-slow: $(STAMP) browser ## the tests that take minutes, and all laws on many examples
	$(BIN)/python -m pytest -m "slow or hypothesis" --hypothesis-profile thorough

lint: $(STAMP) ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

docs: $(STAMP) ## the documentation as a site, in build/docs; a dead link is an error
	$(BIN)/python -m sphinx -b html -n -W --keep-going -d build/doctrees docs build/docs

bench: $(STAMP) ## tables of speed and memory
	for name in simulation data_read train_step decision height_map correlation; do \
	    echo "== $$name"; $(BIN)/python benchmarks/$$name.py || exit; done

results: $(STAMP) ## measure everything that docs/results/ quotes, again: many hours on two cores
	$(BIN)/python benchmarks/collection.py --out runs/recording
	for cell in 16 17 18 19; do \
	    $(BIN)/baggie collect --attempts 260 --seed $$cell --cell $$cell --out runs/recordings/cell-$$cell || exit; done
	$(BIN)/baggie collect --attempts 460 --seed 15 --cell 15 --out runs/recordings/cell-15
	$(BIN)/baggie collect --scenery varied --attempts 260 --seed 16 --cell 16 --out runs/recordings/varied-16
	$(BIN)/python benchmarks/policies.py
	$(BIN)/python benchmarks/generalisation.py
	$(BIN)/python benchmarks/data_curve.py
	$(BIN)/python benchmarks/ablations.py
	for experiment in curves virtual-goals printed-card color-mask report; do \
	    $(BIN)/python benchmarks/published.py $$experiment || exit; done
	for protocol in few "whole-scenes --counts 1 10" published; do \
	    $(BIN)/python benchmarks/pyramid.py $$protocol || exit; done
	$(BIN)/python benchmarks/pyramid_media.py
	for benchmark in decision train_step transporter block_demonstrations demonstration_style rehearsal rehearsal_media landing; do \
	    $(BIN)/python benchmarks/$$benchmark.py || exit; done
	$(BIN)/python benchmarks/rehearsal.py --learn --size 640x480 --attempts 160 \
	    --out runs/night-640x480 --results docs/results/night-640x480
	$(BIN)/python benchmarks/handling_media.py
	$(BIN)/python benchmarks/stacks.py oracle
	$(BIN)/python benchmarks/stacks.py keypoint
	$(BIN)/baggie evaluate --policy runs/stacks/keypoint-300 --task bag-pyramid --episodes 2 --film 2 --out runs/pyramid-film
	$(BIN)/python benchmarks/stack_media.py --evaluation runs/pyramid-film
	$(BIN)/python benchmarks/lab_tower.py --policy runs/stacks/keypoint-300
	$(BIN)/python benchmarks/goal_card.py
	$(BIN)/python benchmarks/second_look.py
	$(BIN)/python benchmarks/foreign_cell.py
	$(BIN)/python benchmarks/media.py --cell 15 --policy runs/policies/cell-15/keypoint
	$(BIN)/python benchmarks/learned_map.py --policy runs/policies/cell-15/keypoint --data runs/recordings/cell-15
	$(BIN)/python benchmarks/faults.py --moments 20
	$(BIN)/python benchmarks/calibration.py --out runs/calibration
	$(BIN)/python benchmarks/calibration_media.py --out runs/calibration-media
	$(BIN)/python benchmarks/bowed_boards.py --out runs/bowed-boards

lerobot: $(STAMP) ## check with LeRobot's own tools, in an environment of its own, that they take our recordings
	test -x .venv-lerobot/bin/python || python3.12 -m venv .venv-lerobot
	.venv-lerobot/bin/python -m pip install --quiet "lerobot[training,dataset-viz]==0.6.1" scipy tyro # which Baggie's data needs
	rm -rf build/lerobot
	PYTHONPATH=src .venv-lerobot/bin/python tests/lerobot/check_lerobot.py build/lerobot

clean: ## remove what was built, and the environment
	rm -rf $(VENV) .venv-lerobot .venv-pybullet build demo .pytest_cache .ruff_cache .mypy_cache .hypothesis src/*.egg-info

$(STAMP): constraints.txt pyproject.toml | machine
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	@touch $@

# Before anything is downloaded; -I, as the modules beside that file are not Python's own.
.PHONY: machine
machine:
	@python=$$(command -v $(BIN)/python || echo $(PYTHON)); \
	$$python -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || { \
	    echo "error: Python 3.11 to 3.13 is needed, $$($$python --version 2>&1) came; say which: make PYTHON=python3.11"; exit 1; }; \
	$$python -I src/baggie/system_libraries.py

# The report is looked at in a browser by a test, which says how to have it run where none may be installed.
.PHONY: browser
browser: | machine
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || { \
	    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	        echo "installing chromium, for the test that looks at the report"; \
	        apt-get -qq update && DEBIAN_FRONTEND=noninteractive \
	            apt-get -qq install -y --no-install-recommends chromium >/dev/null || true; \
	    fi; }
