# Needs make and Python >= 3.11 with its venv module; everything else is installed below .venv.
PYTHON ?= python3
OUT ?= demo-out

BIN := .venv/bin
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# The tests start hundreds of processes: without compiled files each compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all check words torture recordings pages pictures gallery notebooks contact-sheet bench clean

demo: .venv/installed
	$(BIN)/python -m turtlelog demo -o $(OUT)

# Of costly tests of one kind `make test` runs one; all of them run in `make test-all`.
test: CHOSEN := and not thorough
test-all: CHOSEN :=
test-all: export PYTEST_ADDOPTS += --hypothesis-profile=thorough

# Workers fill the cores: threads for small matrices beside them only wait for each other.
test test-all: export OPENBLAS_NUM_THREADS := 1
test: .venv/compiled
test-all: .venv/compiled-all
test test-all:
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not realtime $(CHOSEN)"
	$(BIN)/python -m pytest -n 3 -m "realtime $(CHOSEN)" \
		$$(grep -rl realtime tests --include='test_*.py')

# Once: each worker of the tests would compile the loops, and the tests' own files, for itself.
LOOPS := $(wildcard turtlelog/*.py turtlelog/effects/*.py turtlelog/laws/*.py turtlelog/plants/*.py) \
	$(wildcard turtlelog/simulate/*.py turtlelog/run/*.py turtlelog/sweep/batch*.py)
.venv/compiled: .venv/installed-dev $(LOOPS)
	$(BIN)/python -m tests.compile_loops
	$(BIN)/python -m pytest --collect-only -q > /dev/null
	@touch $@

.venv/compiled-all: .venv/installed-dev $(LOOPS)
	$(BIN)/python -m tests.compile_loops all
	$(BIN)/python -m pytest --collect-only -q > /dev/null
	@touch .venv/compiled $@

check: .venv/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy --num-workers auto
	$(BIN)/lint-imports

# README and docs, page by page: words, the median sentence, sentences and words to rewrite.
words: .venv/installed-dev
	@$(BIN)/python -m tests.docs.plain_words

# Every cut and every flipped bit of a small recording, a hundred killed recorders.
torture: .venv/installed-dev
	TORTURE=full $(BIN)/python -m pytest -s tests/torture

# The paper's four runs, as they stand in the repository.
recordings: .venv/installed
	for kp in 1 2 4 10; do \
		$(BIN)/python -m turtlelog run paper-kp$$kp -o recordings/paper/kp$$kp.mcap > /dev/null || exit 1; \
	done

# The pictures of the pages: of the headless viewer, and figures as for print.
pictures: .venv/installed
	$(BIN)/python -m turtlelog view recordings/paper/kp1.mcap recordings/paper/kp2.mcap \
		recordings/paper/kp4.mcap recordings/paper/kp10.mcap \
		--snapshot docs/images/comparison.png --at 6 --size 1200x860
	$(BIN)/python -m turtlelog view recordings/paper/kp10.mcap \
		--snapshot docs/images/run.png --at 6 --size 1200x860
	$(BIN)/python -m turtlelog explain recordings/paper/kp10.mcap \
		--rrd .venv/explanation.rrd > /dev/null
	$(BIN)/python -m turtlelog view .venv/explanation.rrd \
		--snapshot docs/images/explanation.png --at 12.6 --size 1200x860
	$(BIN)/python -m turtlelog plot recordings/paper/kp1.mcap recordings/paper/kp2.mcap \
		recordings/paper/kp4.mcap recordings/paper/kp10.mcap \
		-o docs/images --format svg \
		--only plant,step-responses,root-locus,heading,panel,speed,wanted-speed,plane,gains
	$(BIN)/python -m turtlelog plot recordings/paper/kp10.mcap -o docs/images --format svg \
		--only attribution,violation,luck --expect 'always(abs(cross_track) <= 0.05)'

# One picture of each kind, by the commands of docs/gallery.md.
gallery: .venv/installed-dev
	$(BIN)/python -m tests.docs.gallery

# What the commands of the pages print; PAGES="metrics why" chooses. Read the difference.
pages: .venv/installed-dev
	$(BIN)/python -m tests.docs.console_pages $(PAGES)

# The pages of the notebooks, with their outputs.
notebooks: .venv/installed-dev
	$(BIN)/python -m tests.docs.notebook_pages

# Odd runs in every view, figure, movie and report, on one sheet to be looked at.
contact-sheet: .venv/installed-dev
	$(BIN)/python tests/draw/contact_sheet.py .venv/contact-sheet.png $(BAG)

# One table of what jobs cost; ONLY="engine loop" chooses, PAGE=docs/performance.md writes it there.
bench: .venv/installed-dev
	$(BIN)/python benchmarks/run_all.py $(ONLY) $(if $(PAGE),--write $(PAGE))

clean:
	rm -rf .venv demo-out dist

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "turtlelog needs Python >= 3.11")'
	$(PYTHON) -m venv .venv

# What is imported is compiled then; all of it would take as long as its installation.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --editable

.venv/installed: .venv/bin/python pyproject.toml constraints.txt
	$(INSTALL) .
	@touch $@

# uv takes a third of pip's time; where it finds no packages, as behind an index that only pip knows,
# pip installs them.
.venv/installed-dev: .venv/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --no-compile uv && $(BIN)/uv pip install --quiet \
		--python $(BIN)/python --editable '.[dev]' || $(INSTALL) '.[dev]'
	@touch .venv/installed $@
