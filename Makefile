# Penumbra's front door and the map of the experiment: every result is a file with a rule.
# `make help` prints the targets; `make -n report` shows what a page is made of.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SECONDEXPANSION:
.SUFFIXES:
# One step at a time, even under -j: each uses every core, and some measure time.
.NOTPARALLEL:
MAKEFLAGS += --no-builtin-rules
# Without bytecode every command spends seconds on compiling what it imports.
unexport PYTHONDONTWRITEBYTECODE

## help : list the targets
.PHONY: help
help:
	@sed -n 's/^## //p' $(MAKEFILE_LIST)

# ---------------------------------------------------------------- set-up

# Installs what is missing; not asked again until what it installs changes. See setup.sh.
build/setup.run: setup.sh requirements.txt pyproject.toml
	./setup.sh run
	@touch $@

build/setup.course: build/setup.run
	./setup.sh course
	@touch $@

build/setup.test: build/setup.course
	./setup.sh test
	@touch $@

UV_COMPILE = build/lock/bin/uv pip compile --upgrade --universal --python-version 3.11 --generate-hashes \
    --no-header --no-annotate --quiet

## lock : pin what pyproject.toml asks for anew in requirements*.txt, at the newest versions
.PHONY: lock
lock: | build/setup.run
	.venv/bin/python -m venv build/lock
	build/lock/bin/pip install --quiet --disable-pip-version-check uv
	$(UV_COMPILE) pyproject.toml --all-extras --group dev --output-file requirements.txt
	$(UV_COMPILE) requirements-bench.in --output-file requirements-bench.txt

# ---------------------------------------------------------------- C renderer

VERSION := $(shell sed -n 's/^version = "\([^"]*\)".*/\1/p' pyproject.toml)
C_NAMES := $(patsubst c_renderer/src/%.c,%,$(wildcard c_renderer/src/*/*.c))

# OpenEXR's headers warn under -Wpedantic: -isystem. Asked of pkg-config when a recipe runs, not
# when this file is read, since set-up may just have installed it.
LIB_CFLAGS  = $(shell pkg-config --cflags jansson) \
              $(patsubst -I%,-isystem %,$(shell pkg-config --cflags-only-I OpenEXR))
# Of OpenEXR's libraries only the C one, whatever version its name carries.
LIB_LDFLAGS = $(shell pkg-config --libs jansson) \
              $(filter -L% -lOpenEXRCore%,$(shell pkg-config --libs OpenEXR)) -lm

# -fno-math-errno: without it gcc keeps every square root scalar.
C_FLAGS := -std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wswitch-enum -Ic_renderer/src -fPIC -fopenmp -fno-math-errno \
           -DPENUMBRA_VERSION='"$(VERSION)"'

CONTRACTED := $(filter core/% packet/% frame/%,$(C_NAMES))

# One build, in folder $(1), once set up for $(2), by compiler $(3) with flags $(4), its name ending
# in $(5): bin/penumbra-render, and lib/libpenumbra.so of the same objects but main.
define c_build
$(1)/obj$(5)/%.o: c_renderer/src/%.c Makefile pyproject.toml | build/setup.$(2)
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) $$(LIB_CFLAGS) -MMD -MP -c $$< -o $$@

$(1)/bin/penumbra-render$(5): $(C_NAMES:%=$(1)/obj$(5)/%.o)
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) $$^ $$(LIB_LDFLAGS) -o $$@.part && mv $$@.part $$@

$(1)/lib/libpenumbra$(5).so: $(patsubst %,$(1)/obj$(5)/%.o,$(filter-out io/main,$(C_NAMES)))
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) -shared $$^ $$(LIB_LDFLAGS) -o $$@.part && mv $$@.part $$@

# Fused multiply-add where pixels are made, in all of it alike: the textbook's pixels are the same
# bits in program and library. Of packets, where the compiler's inlining decides what is fused, a
# few on a rim differ in the last ones. Elsewhere, and so in the scene reader and the textbook's
# exact irradiance, C99's plain arithmetic.
$(addprefix $(1)/obj$(5)/,$(CONTRACTED:%=%.o)): C_FLAGS += -ffp-contract=fast

-include $(C_NAMES:%=$(1)/obj$(5)/%.d)
endef

# gcc 12 would use half of AVX-512's width.
RELEASE := -O3 -march=native -mprefer-vector-width=512 -fno-tree-loop-distribute-patterns -flto=auto
CHECKED := -O1 -g -fno-omit-frame-pointer -fno-sanitize-recover=all
$(eval $(call c_build,build,run,gcc,$(RELEASE)))
$(eval $(call c_build,build,run,gcc,$(RELEASE) -DPENUMBRA_FLOAT64,-float64))
$(eval $(call c_build,build/asan,test,gcc,$(CHECKED) -fsanitize=address -fsanitize=undefined))
$(eval $(call c_build,build/tsan,test,clang,$(CHECKED) -fsanitize=thread -Wno-pass-failed))
# For any processor, in C99's plain arithmetic: valgrind does not know the newest ones' instructions,
# and a page's module computes the same bits.
$(eval $(call c_build,build/plain,test,gcc,$(CHECKED) -ffp-contract=off))

## build : the renderer, build/bin/penumbra-render, and build/lib/libpenumbra.so; and in float64
.PHONY: build
build: $(foreach product,bin/penumbra-render bin/penumbra-render-float64 lib/libpenumbra.so \
    lib/libpenumbra-float64.so,build/$(product))

# Where shadow rays should start: a study in both precisions, of the renderer's own functions.
SELF_SHADOW := build/lib/libself_shadow.so build/lib/libself_shadow-float64.so
$(SELF_SHADOW): penumbra/compare/studies/self_shadow.c $(wildcard c_renderer/src/core/*.[ch]) Makefile | build/setup.run
	@mkdir -p $(@D)
	gcc $(C_FLAGS) -O3 -march=native -ffp-contract=fast \
	    $(if $(findstring -float64,$@),-DPENUMBRA_FLOAT64) -shared $(filter %.c,$^) -lm -o $@.part && mv $@.part $@
build: $(SELF_SHADOW)

# The estimator with the mistakes of the catalogue, in double: a library of its own.
MISTAKES := build/lib/libmistakes.so
PLAIN_LIBRARIES := build/plain/lib/libpenumbra.so build/plain/lib/libmistakes.so
MISTAKES_SOURCES := $(wildcard c_renderer/mistakes/* c_renderer/src/core/*.[ch])
$(MISTAKES) build/plain/lib/libmistakes.so: $(MISTAKES_SOURCES) build/obj-float64/io/scene_json.o Makefile
	@mkdir -p $(@D)
	gcc $(C_FLAGS) $(if $(findstring /plain/,$@),-O2 -ffp-contract=off,\
	        -O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast) \
	    -DPENUMBRA_FLOAT64 -shared $(filter %.c %.o,$^) $(shell pkg-config --libs jansson) -lm \
	    -o $@.part && mv $@.part $@
build: $(MISTAKES)

# ---------------------------------------------------------------- languages

# What Penumbra says in French.
FRENCH := penumbra/locale/fr/LC_MESSAGES/penumbra.mo
%.mo: %.po | build/setup.run
	.venv/bin/pybabel --quiet compile --input-file $< --output-file $@.part && mv $@.part $@
build: $(FRENCH)

## words : gather what is to be translated, and note which texts agree: docs/translating.md
.PHONY: words
words: build/setup.run
	.venv/bin/python -P -m penumbra.translation $(SAME)
	@$(MAKE) --no-print-directory $(FRENCH)

# ---------------------------------------------------------------- the experiment

PENUMBRA := .venv/bin/penumbra
RENDER   := build/bin/penumbra-render
LIGHTS   := tp3_sheared tp3_disk tp3_triangle tp3_sphere tp3_two_lights
SCENES   := tp3 tp3_statement tp3_point $(LIGHTS)

## render : the lab's scene: build/tp3.exr, and build/tp3.png as the lab saves it
.PHONY: render
render: build/tp3.png

build/tp3.exr: scenes/tp3.json $(RENDER)
	$(RENDER) $< -o $@

build/tp3.png: build/tp3.exr
	$(PENUMBRA) png $< -o $@

# build/images/SCENE_nN_mM.exr: N light samples and M pixel samples, as the name says.
pixel_samples = $(lastword $(subst _m, ,$(1)))
light_samples = $(lastword $(subst _n, ,$(1:_m$(pixel_samples)=)))
scene         = $(1:_n$(light_samples)_m$(pixel_samples)=)

# The lab's own scenes with independent samples, whose variance tells their error; its other lights
# with well-spread ones, a sphere over the cone that is seen of it.
how = $(if $(filter $(LIGHTS),$(1)),--sampler sobol $(if $(filter %_sphere,$(1)),--estimator solid-angle))
build/images/%.exr: scenes/$$(call scene,$$*).json $(RENDER)
	@mkdir -p $(@D)
	$(RENDER) $< --light-samples $(call light_samples,$*) --pixel-samples $(call pixel_samples,$*) \
	    --seed 1 $(call how,$(call scene,$*)) -o $@

## reference : each scene in Cycles, build/reference/*.exr
.PHONY: reference
reference: $(SCENES:%=build/reference/%.exr)

# As many samples as it takes to tell a bias of 0.1%; a point light has no noise. Under the other
# lights fewer pixels have more samples each: those of a pixel are well spread, so that the same
# certainty costs less. As many pixels as make 10 tiles of 8 x 8 of each umbra, to be judged.
SAMPLES               := 1024
SAMPLES_tp3           := 256
SAMPLES_tp3_statement := 128
SAMPLES_tp3_point     := 16
size = $(if $(filter $(LIGHTS),$(1)),--width 270 --height 180)
# Without Cycles (exit status 3): the small reference that the repository holds.
build/reference/%.exr: scenes/%.json $(wildcard penumbra/blender_ref/*.py) | build/setup.run
	@mkdir -p $(@D)
	$(PENUMBRA) reference $< -o $@ $(call size,$*) --samples $(or $(SAMPLES_$*),$(SAMPLES)) || \
	    { [ $$? -eq 3 ] && cp penumbra/blender_ref/shipped/$*.exr $@.part && mv $@.part $@; }

# Ours: the image of the most light samples. A point light needs but one.
MOST               := 1024
MOST_tp3           := 32768
MOST_tp3_statement := 32768
MOST_tp3_point     := 1
most = $(or $(MOST_$(1)),$(MOST))
ours = build/images/$(1)_n$(call most,$(1))_m1.exr

# ... and of the reference's size.
small = $(if $(filter $(LIGHTS),$(1)),build/images/$(1)_small.exr,$(call ours,$(1)))
build/images/%_small.exr: scenes/%.json $(RENDER)
	@mkdir -p $(@D)
	$(RENDER) $< --light-samples 4096 --seed 1 $(call how,$*) $(call size,$*) -o $@

COMPARE := $(wildcard penumbra/compare/*.py penumbra/compare/*/*.py)

# Verdicts: build/agreement/SCENE_IMAGE_REFERENCE.json, and .txt for reading. The last argument is the
# largest exit status that is a result: 1, "differs", always is; 2 where the two differ in size, as
# the small references in the repository do. Three at a time: each uses one core.
verdict = $(PENUMBRA) compare $(2) $(3) --scene scenes/$*.json $(if $(filter tp3,$*),--perceptual) \
    --json $(@D)/$*_$(1).json >$(@D)/$*_$(1).txt || [ $$? -le $(4) ]
build/agreement/%_c_exact.json build/agreement/%_cycles_exact.json build/agreement/%_c_cycles.json: \
    $$(call ours,$$*) $$(call small,$$*) build/reference/%.exr scenes/%.json $(COMPARE)
	@mkdir -p $(@D)
	{ $(call verdict,c_exact,$(call ours,$*),exact,1); } & first=$$!; \
	{ $(call verdict,cycles_exact,build/reference/$*.exr,exact,1); } & second=$$!; \
	{ $(call verdict,c_cycles,$(call small,$*),build/reference/$*.exr,2); }; third=$$?; \
	wait $$first || third=$$?; wait $$second || third=$$?; exit $$third

# A run that was stopped goes on where it was. Without Cycles: our curves alone.
CONVERGE = $(PENUMBRA) converge $< -o build/convergence/tp3 --pixel-samples 1,16
build/convergence/tp3.csv build/convergence/tp3.json &: scenes/tp3.json $(RENDER) $(COMPARE)
	$(CONVERGE) --cycles 1..64 || { [ $$? -eq 3 ] && $(CONVERGE); }

build/speedup.csv build/speedup.json &: scenes/tp3.json $(RENDER) $(COMPARE)
	$(PENUMBRA) speedup $< -o build/speedup.csv

# What each millisecond buys. Without Cycles (exit status 3): the C renderer alone.
TRADE = $(PENUMBRA) trade $< -o build/trade/$* --keep-images \
    --verify $(filter-out $<,$(wildcard scenes/small_light.json scenes/three_spheres.json))
build/trade/%.json: scenes/%.json $(RENDER) build/lib/libpenumbra.so $(COMPARE)
	$(TRADE) --cycles || { [ $$? -eq 3 ] && $(TRADE); }

## trade : error against time for every method, and which to use
.PHONY: trade
trade: build/trade/tp3.json

## stability : where floats break, in float32 and float64
.PHONY: stability
stability: build/stability/stability.json

build/stability/stability.csv build/stability/stability.json &: $(wildcard c_renderer/src/*/*.[ch]) \
    $(COMPARE) | build
	$(PENUMBRA) stability -o build/stability/stability

## self-shadow : where shadow rays should start, on a map
.PHONY: self-shadow
self-shadow: build/stability/self_shadow.json

build/stability/self_shadow.csv build/stability/self_shadow.json &: penumbra/compare/studies/self_shadow.py \
    scenes/tp3.json $(SELF_SHADOW)
	$(PENUMBRA) self-shadow -o build/stability/self_shadow

## calibrate : how often `penumbra check` is wrong, docs/calibration.json: 10 minutes
.PHONY: calibrate
calibrate: build
	$(PENUMBRA) calibrate -o docs/calibration.json

# The shadow along a line, under each light.
build/lights/profile.json: scenes/tp3.json $(LIGHTS:%=scenes/%.json) $(COMPARE) | build/setup.run
	$(PENUMBRA) profile $(filter %.json,$^) -o $@

IMAGES := $(LIGHTS:%=%_small) tp3_n4_m1 tp3_n4_m16 tp3_n64_m1 $(foreach n,1 4 16 64 256,tp3_statement_n$(n)_m1) \
          $(foreach name,$(SCENES),$(name)_n$(call most,$(name))_m1)
PAIRS  := $(foreach pair,c_exact cycles_exact c_cycles,$(SCENES:%=%_$(pair)))

# The first of these that is set says the language, as everywhere; French or English.
SPOKEN := $(if $(filter fr%,$(firstword $(LANGUAGE) $(LC_ALL) $(LC_MESSAGES) $(LANG))),fr,en)

# The benchmark takes longer than all the rest: the page shows it once it has been run.
## report : all of the above, measured, on one page, build/report/index.html; LANG=fr make report: in French
.PHONY: report
report: build/report/index.html

# There is one, so that the page is made anew where another language is spoken than last time.
build/report/spoken.$(SPOKEN):
	@mkdir -p $(@D)
	rm -f $(@D)/spoken.* && touch $@

build/report/index.html: $(FRENCH) build/report/spoken.$(SPOKEN) $(IMAGES:%=build/images/%.exr) $(SCENES:%=build/reference/%.exr) \
    $(PAIRS:%=build/agreement/%.json) build/convergence/tp3.csv build/speedup.csv \
    build/lights/profile.json build/trade/tp3.json build/stability/stability.json build/stability/self_shadow.json \
    $(wildcard build/bench/bench.json) docs/calibration.json \
    $(wildcard penumbra/*.py penumbra/cli/*.py penumbra/report/*.py penumbra/report/template/* penumbra/locale/*/*/*.po)
	$(PENUMBRA) report --lang $(SPOKEN) -o $@

# ---------------------------------------------------------------- the course

# The renderer, and the library of mistakes in double, for a page: WebAssembly of 1 MB of stack,
# whose overflow traps since it lies first. C99's plain arithmetic, in vectors of four whatever width
# a loop asks for: a macro of that name takes the place of `simdlen(16)`. Not linked by clang, which
# would run whatever wasm-opt there is.
WASM := build/wasm/core.wasm build/wasm/mistakes.wasm
WASM_CC := clang --target=wasm32-wasi -msimd128 -mbulk-memory -mnontrapping-fptoint -msign-ext -std=c99 -O2 \
    -fopenmp-simd -fno-math-errno -ffp-contract=off '-Dsimdlen(any)=simdlen(4)' -Wall -Wextra -Wno-pass-failed \
    -Wno-unknown-pragmas -Ic_renderer/src -Ic_renderer/wasm
# What clang needs beside the C library stands where its version likes: set-up asks the same way.
WASM_LD = wasm-ld --no-entry --stack-first -z stack-size=1048576 --strip-all --export=malloc --export=free \
    $^ -L/usr/lib/wasm32-wasi -lc \
    $$(find "$$(clang --print-resource-dir)/lib/" -path '*wasm32*' -name 'libclang_rt.builtins*.a' -print -quit)

# Module $(1), of the sources $(2) in c_renderer/, with flags $(3).
define wasm_build
build/wasm/obj-$(1)/%.o: c_renderer/%.c Makefile | build/setup.course
	@mkdir -p $$(@D)
	$$(WASM_CC) $(3) -MMD -MP -c $$< -o $$@

build/wasm/$(1).wasm: $(2:%=build/wasm/obj-$(1)/%.o)
	$$(WASM_LD) -o $$@.part && mv $$@.part $$@

-include $(2:%=build/wasm/obj-$(1)/%.d)
endef
$(eval $(call wasm_build,core,$(addprefix src/,$(filter-out io/% frame/trust,$(C_NAMES))) wasm/core wasm/scene))
$(eval $(call wasm_build,mistakes,$(patsubst c_renderer/%.c,%,$(wildcard c_renderer/mistakes/*.c c_renderer/src/core/*.c)) \
    src/packet/packet wasm/mistakes wasm/scene,-DPENUMBRA_FLOAT64))

## course : the lesson and what a teacher hands out, in French and English: build/course/
.PHONY: course
course: build/course/index.html

# Last of all: the handouts, which are rendered, come before it.
build/course/index.html: $(FRENCH) $(WASM) $(RENDER) $(MISTAKES) $(wildcard scenes/*.json) penumbra/grading/rubric.toml \
    $(wildcard penumbra/*.py penumbra/compare/cpp.py penumbra/course/*.py penumbra/course/*/* penumbra/course/*/*/*)
	$(PENUMBRA) course -o $(@D)

# ---------------------------------------------------------------- benchmark

BENCH_PROGRAMS := build/bin/penumbra-loop build/bin/scalar-loop build/bin/fma-peak

build/bin/fma-peak: bench/fma_peak.c Makefile | build/setup.run
	@mkdir -p $(@D)
	gcc $(C_FLAGS) $(RELEASE) -ffp-contract=fast $< -o $@

# Of the same objects as the program, since the linker optimises: what is timed is what is run.
LOOP_OBJECTS := $(patsubst %,build/obj/%.o,$(filter-out io/main,$(C_NAMES)))
LOOP = gcc $(C_FLAGS) $(RELEASE) $(filter %.c %.o,$^)

build/bin/penumbra-loop: bench/loop.c $(LOOP_OBJECTS)
	@mkdir -p $(@D)
	$(LOOP) $(LIB_LDFLAGS) -o $@

build/bin/scalar-loop: bench/loop.c bench/scalar.c bench/other.h $(LOOP_OBJECTS)
	@mkdir -p $(@D)
	$(LOOP) -DOTHER -ffp-contract=fast $(LIB_LDFLAGS) -o $@

# Optional: embree3 or embree4, if Debian's libembree-dev is installed.
EMBREE := $(lastword $(sort $(notdir $(patsubst %/rtcore.h,%,$(wildcard /usr/include/embree*/rtcore.h)))))

build/bin/embree-loop: bench/loop.c bench/embree.c bench/other.h $(LOOP_OBJECTS)
	@mkdir -p $(@D)
	$(LOOP) -DOTHER $(LIB_LDFLAGS) -l$(EMBREE) -o $@

## bench : speed beside Cycles, Mitsuba, Embree and a textbook loop: build/bench/, docs/performance.md
.PHONY: bench
bench: build $(BENCH_PROGRAMS) $(if $(EMBREE),build/bin/embree-loop)
	.venv/bin/python -P -m bench scenes/tp3.json -o build/bench --page docs/performance.md

## bench-extras : install Mitsuba in .venv for the benchmark, which does without it too
.PHONY: bench-extras
bench-extras: build/setup.run
	.venv/bin/pip install --quiet --disable-pip-version-check --require-hashes \
	    --requirement requirements-bench.txt

# ---------------------------------------------------------------- package

# With what set-up pinned, and no network; auditwheel puts the library jansson into it.
build/wheel/made: CMakeLists.txt pyproject.toml $(MISTAKES_SOURCES) \
    $(wildcard LICENSE* scenes/*.json c_renderer/src/io/scene_json.[ch]) \
    $(shell find penumbra -type f -not -name '*.pyc') | build/setup.run
	rm -rf $(@D)
	.venv/bin/pip wheel --quiet --disable-pip-version-check --no-index --no-deps --no-build-isolation \
	    --wheel-dir $(@D)/unrepaired .
	PATH="$(CURDIR)/.venv/bin:$$PATH" .venv/bin/auditwheel repair --wheel-dir $(@D) \
	    $(@D)/unrepaired/*.whl
	@touch $@

## wheel : the package for pip, build/wheel/*.whl: check, compare, exact and scene without a compiler
.PHONY: wheel
wheel: build/wheel/made

# ---------------------------------------------------------------- checks

# The scene reader for libFuzzer, which makes up what the reader has not met yet.
build/fuzz/bin/scene-reader: tests/fuzz/scene_reader.c c_renderer/src/io/scene_json.c \
    $(wildcard c_renderer/src/core/*.c c_renderer/src/*/*.h) Makefile | build/setup.test
	@mkdir -p $(@D)
	clang $(C_FLAGS) $(CHECKED) -fsanitize=fuzzer,address,undefined $(LIB_CFLAGS) \
	    $(filter %.c,$^) $(LIB_LDFLAGS) -o $@.part && mv $@.part $@

PYTHON_FILES := penumbra bench tests

## test : lint, then every test; installs browsers, clang and valgrind for them if missing
.PHONY: test
test: build/setup.test lint build wheel $(BENCH_PROGRAMS) $(foreach kind,asan tsan plain,build/$(kind)/bin/penumbra-render) \
    $(PLAIN_LIBRARIES) $(WASM) build/fuzz/bin/scene-reader
	.venv/bin/pytest -n auto --maxprocesses 8

NUMBERS_TIMES ?= 20
## stress-numbers : every numeric sweep in full, and NUMBERS_TIMES=20 times the cases of the tests
.PHONY: stress-numbers
stress-numbers: build/stability/stability.json build
	PENUMBRA_STRESS=$(NUMBERS_TIMES) .venv/bin/pytest --timeout=0 \
	    tests/test_stability.py tests/test_terms.py tests/test_precision.py

## stress : every check that takes hours: stress-fuzz and stress-numbers
.PHONY: stress
stress: stress-fuzz stress-numbers

# For each of the two scene readers: libFuzzer counts time on the clock, the tests that of the
# processor, of which those of images and signals take a sixth each.
FUZZ_SECONDS ?= 3600
FUZZER = build/fuzz/bin/scene-reader -dict=tests/fuzz/scene.dict -max_len=4096 \
    -artifact_prefix=build/fuzz/found/

## stress-fuzz : fuzz both scene readers for FUZZ_SECONDS=3600 each
# ASan need not remember what was freed many files ago, nor fill the reader's megabyte each time.
.PHONY: stress-fuzz
stress-fuzz: build build/fuzz/bin/scene-reader build/asan/bin/penumbra-render
	@mkdir -p build/fuzz/corpus build/fuzz/found
	ASAN_OPTIONS=quarantine_size_mb=4:max_malloc_fill_size=0 \
	    $(FUZZER) -max_total_time=$(FUZZ_SECONDS) build/fuzz/corpus tests/fuzz/corpus
	FUZZ_SECONDS=$(FUZZ_SECONDS) .venv/bin/pytest -rP --timeout=0 \
	    tests/test_fuzz_scene.py tests/test_fuzz_image.py tests/test_outputs.py

## fuzz-corpus : keep the new files of stress-fuzz in tests/fuzz/corpus
.PHONY: fuzz-corpus
fuzz-corpus: build/fuzz/bin/scene-reader
	$(FUZZER) -merge=1 tests/fuzz/corpus build/fuzz/corpus

## lint : style and types, Python and C
.PHONY: lint
lint: build/setup.run
	.venv/bin/ruff check $(PYTHON_FILES)
	.venv/bin/ruff format --check $(PYTHON_FILES)
	.venv/bin/mypy
	.venv/bin/clang-format --dry-run -Werror c_renderer/src/*/*.[ch] c_renderer/mistakes/*.[ch] c_renderer/wasm/*.[ch] bench/*.[ch] penumbra/compare/*/*.c tests/fuzz/*.c

## format : rewrite Python and C in the style that lint asks for
.PHONY: format
format: build/setup.run
	.venv/bin/ruff check --fix $(PYTHON_FILES)
	.venv/bin/ruff format $(PYTHON_FILES)
	.venv/bin/clang-format -i c_renderer/src/*/*.[ch] c_renderer/mistakes/*.[ch] c_renderer/wasm/*.[ch] bench/*.[ch] penumbra/compare/*/*.c tests/fuzz/*.c

## clean : remove build/, everything that was built, rendered or measured
.PHONY: clean
clean:
	rm -rf build

## distclean : remove what set-up made in this folder too
.PHONY: distclean
distclean: clean
	rm -rf .venv *.egg-info
