# Lodestream. `make run` serves a sample model; `make test` runs every test; `make help` lists the rest.
#
# config=release|debug|sanitize|fuzz chooses flags and the folder build/$(config). Sources are found by folder: a new .c file needs no line here.

config ?= release
PREFIX ?= /usr/local
B := build/$(config)

CC_release := gcc
CXX_release := g++
CC_debug := gcc
CXX_debug := g++
CC_sanitize := clang
CXX_sanitize := clang++
CC_fuzz := clang
CXX_fuzz := clang++
CC := $(CC_$(config))
CXX := $(CXX_$(config))

FLAGS_release := -O3 -g1 -DNDEBUG
FLAGS_debug := -O1 -g
FLAGS_sanitize := -O1 -g -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=undefined
FLAGS_fuzz := -O2 -g -fno-omit-frame-pointer -fsanitize=address,undefined,fuzzer-no-link -fno-sanitize-recover=undefined

# V=1 shows the commands.
Q := $(if $(V),,@)
say := @$(if $(V),:,echo)
VERSION := $(shell cat VERSION)
WARN := -Wall -Wextra -Wshadow -Wvla -Wpointer-arith -Werror
# -ffp-contract=off: the same bits on every machine and in WebAssembly.
COMMON := -I. -D_GNU_SOURCE -DLOD_VERSION='"$(VERSION)"' -ffp-contract=off -fno-math-errno -pthread -MMD -MP $(FLAGS_$(config))
CFLAGS := -std=c17 $(COMMON) $(WARN) -Wstrict-prototypes -Wmissing-prototypes
CXXFLAGS := -std=c++17 $(COMMON) $(WARN)
LDFLAGS := -pthread $(FLAGS_$(config))

# Libraries by what links them; lodestreamd links no geometry and no codec.
LIBS_daemon := -lmicrohttpd -lgnutls -lsqlite3 -ljansson -lnettle -lz -lm
LIBS_codec := -ldraco -lassimp -lpng -lz -lstdc++
LIBS_tool := $(LIBS_codec) -ljansson -lnettle -lcurl -lseccomp -lm
LIBS_test := -lcmocka $(LIBS_codec) -lmicrohttpd -lgnutls -lsqlite3 -ljansson -lnettle -lcurl -lseccomp -lz -lm
LIBS_bench := -lmeshoptimizer

SRC_base := $(wildcard core/base/*.c) core/level/screen.c
SRC_core := $(filter-out $(SRC_base),$(wildcard core/*/*.c))
SRC_codec := $(wildcard codec/*/*.c) $(wildcard codec/*/*.cc)
SRC_worker := $(wildcard server/worker/*.c) server/jobs/frame.c server/jobs/refine_query.c
SRC_server := $(wildcard server/*.c server/http/*.c server/store/*.c server/jobs/*.c)
SRC_cli := $(wildcard clients/cli/*.c)
SRC_native := $(filter-out clients/native/example.c,$(wildcard clients/native/*.c))

objects = $(addsuffix .o,$(addprefix $(B)/,$(basename $(1))))
OBJ_base := $(call objects,$(SRC_base))
OBJ_core := $(call objects,$(SRC_core))
OBJ_codec := $(call objects,$(SRC_codec))
OBJ_worker := $(call objects,$(SRC_worker))
OBJ_server := $(call objects,$(filter-out server/main.c,$(SRC_server)))
OBJ_native := $(call objects,$(SRC_native))
OBJ_cli := $(call objects,$(filter-out clients/cli/main.c,$(SRC_cli)))

UNIT := $(patsubst %.c,$(B)/%,$(shell find tests/unit tests/property tests/golden -name '*_test.c' 2>/dev/null | LC_ALL=C sort))
BENCH := $(patsubst %.c,$(B)/%,$(wildcard tests/bench/*_bench.c))
FUZZ := $(patsubst %.c,$(B)/%,$(wildcard tests/fuzz/*_fuzz.c))
HELPERS := $(call objects,$(wildcard tests/data/*.c tests/bench/load/*.c))

.PHONY: all help run test test-only bench lint format sanitize fuzz install clean deps web programs bench-stream bench-decode unit-tests fuzz-replay wasm
all: programs

help:
	@sed -n 's/^## //p' Makefile

## make all       build build/release/lodestreamd and build/release/lodestream
## make run       install what is missing, build, bake a sample model, serve it, print the viewer's address
## make test      install what is missing, build, run every test
## make bench     every benchmark; make bench-NAME one of them (cluster, envelope, bake, refine, http, delta, stream, decode)
## make wasm      core and codec for the browser, into build/wasm
## make lint      include rules, link rules, format
## make format    rewrite sources with clang-format
## make sanitize  unit tests under ASan and UBSan
## make fuzz      fuzz every target for SECONDS=60 each
## make install   PREFIX=/usr/local, DESTDIR=

programs: $(B)/lodestreamd $(B)/lodestream $(B)/clients/native/example

$(B)/libbase.a: $(OBJ_base)
$(B)/libcore.a: $(OBJ_core)
$(B)/libcodec.a: $(OBJ_codec)
$(B)/libworker.a: $(OBJ_worker)
$(B)/libserver.a: $(OBJ_server)
$(B)/libcli.a: $(OBJ_cli)
$(B)/libnative.a: $(OBJ_native)
$(B)/libtestdata.a: $(HELPERS)
$(B)/lib%.a:
	@rm -f $@
	@ar qcs $@ $^

$(B)/lodestreamd: $(B)/server/main.o $(B)/libserver.a $(B)/libbase.a
	$(say) "LINK $@"
	$(Q)$(CC) $(LDFLAGS) -o $@ $^ $(LIBS_daemon)

$(B)/lodestream: $(B)/clients/cli/main.o $(B)/libcli.a $(B)/libworker.a $(B)/libcodec.a $(B)/libcore.a $(B)/libbase.a
	$(say) "LINK $@"
	$(Q)$(CXX) $(LDFLAGS) -o $@ $^ $(LIBS_tool)

$(B)/clients/native/example: $(B)/clients/native/example.o $(B)/libnative.a $(B)/libcodec.a $(B)/libcore.a $(B)/libbase.a
	$(say) "LINK $@"
	$(Q)$(CC) $(LDFLAGS) -o $@ $^ -lm

$(B)/%.o: %.c
	@mkdir -p $(@D)
	$(say) "CC   $<"
	$(Q)$(CC) $(CFLAGS) -c -o $@ $<

$(B)/%.o: %.cc
	@mkdir -p $(@D)
	$(say) "CXX  $<"
	$(Q)$(CXX) $(CXXFLAGS) -c -o $@ $<

# Test programs may reach every module; the linker takes what each needs.
TEST_LIBS = $(B)/libtestdata.a $(B)/libcli.a $(B)/libnative.a $(B)/libworker.a $(B)/libserver.a $(B)/libcodec.a $(B)/libcore.a $(B)/libbase.a
link_test = $(Q)$(CXX) $(LDFLAGS) -o $@ $< -Wl,--start-group $(TEST_LIBS) -Wl,--end-group

$(B)/%_test: $(B)/%_test.o $(TEST_LIBS)
	$(link_test) $(LIBS_test)
$(B)/%_bench: $(B)/%_bench.o $(TEST_LIBS)
	$(link_test) $(LIBS_test) $(LIBS_bench)
# A bench in several files, one of them a peer in C++.
OBJ_envelope_bench := $(call objects,$(wildcard tests/bench/envelope_*.c) $(wildcard tests/bench/envelope_*.cc))
$(B)/tests/bench/envelope_bench: $(OBJ_envelope_bench) $(TEST_LIBS)
	$(Q)$(CXX) $(LDFLAGS) -o $@ $(OBJ_envelope_bench) -Wl,--start-group $(TEST_LIBS) -Wl,--end-group $(LIBS_test) $(LIBS_bench)
ifeq ($(config),fuzz)
$(B)/%_fuzz: $(B)/%_fuzz.o $(TEST_LIBS)
	$(link_test) -fsanitize=fuzzer $(LIBS_test)
else
# Without libFuzzer a target replays the files and folders named on its command line.
$(B)/%_fuzz: $(B)/%_fuzz.o $(B)/tests/fuzz/replay.o $(TEST_LIBS)
	$(link_test) $(B)/tests/fuzz/replay.o $(LIBS_test)
endif

$(B)/tests/sample/sample: $(B)/tests/sample/sample.o $(B)/libtestdata.a $(B)/libcore.a $(B)/libbase.a
	$(CC) $(LDFLAGS) -o $@ $^ -lm

$(B)/tests/sample/steps: $(B)/tests/sample/steps.o $(TEST_LIBS)
	$(link_test) $(LIBS_test)

# Embedded with .incbin, which leaves no dependency of its own.
$(B)/server/http/openapi.o: server/http/openapi.json

# WebAssembly: the same C for the browser, one file per module. A new source of a module goes into its list, a new module gets a list and a
# name in WASM_MODULES. No threads, no I/O; all arithmetic as in COMMON, so the bits are the same.
WASM_MODULES := lodestream refine clod
WASM_lodestream := clients/web/src/wasm/module.c core/base/arena.c core/base/status.c \
 core/mesh/mesh.c core/mesh/adjacency.c $(wildcard core/mesh/overlay*.c) \
 $(filter-out codec/stream/%_encode.c,$(wildcard codec/stream/*.c))
WASM_refine := clients/web/src/wasm/refine.c core/base/arena.c core/base/status.c core/mesh/mesh.c core/mesh/adjacency.c \
 core/mesh/feature.c core/mesh/triangle_distance.c $(filter-out core/refine/plain.c core/refine/stepwise.c core/refine/uniform.c,$(wildcard core/refine/*.c))
WASM_clod := clients/web/src/wasm/clod.c core/base/arena.c core/base/status.c core/mesh/mesh.c core/mesh/adjacency.c \
 $(addprefix core/clod/,attributes.c bezier.c cone.c dynamic.c evaluate.c gregory.c halve.c pattern.c patches.c) \
 $(addprefix codec/stream/,patches.c coder.c connectivity.c cut.c bytes.c)
WASM_CC := clang --target=wasm32-wasi
WASM_FLAGS := -std=c17 -I. -D_GNU_SOURCE -DNDEBUG -O3 -msimd128 -ffp-contract=off -fno-math-errno -fno-strict-aliasing -ffunction-sections $(WARN)
WASM_LINK := -nostartfiles -Wl,--no-entry,--gc-sections,--strip-all,--stack-first,-z,stack-size=1048576,--max-memory=2147483648

wasm: $(WASM_MODULES:%=build/wasm/%.wasm)
build/wasm/%.o: %.c
	@mkdir -p $(@D)
	$(say) "WASM $<"
	$(Q)$(WASM_CC) $(WASM_FLAGS) -MMD -MP -c -o $@ $<
$(foreach module,$(WASM_MODULES),$(eval build/wasm/$(module).wasm: $(addprefix build/wasm/,$(WASM_$(module):.c=.o))))
build/wasm/%.wasm:
	@mkdir -p $(@D)
	$(say) "LINK $@"
	$(Q)$(WASM_CC) $(WASM_LINK) -o $@ $^

unit-tests: $(UNIT)
fuzz-replay: $(FUZZ)

.SECONDARY:
-include $(shell find $(B) build/wasm -name '*.d' 2>/dev/null)

deps:
	@deploy/dependencies.sh

web: deps
	@clients/web/build.sh build/web

run: deps web
	@$(MAKE) --no-print-directory -j2 programs $(B)/tests/sample/sample
	@deploy/run-sample.sh $(B)

test: deps
	@$(MAKE) --no-print-directory test-only

test-only: web
	@$(MAKE) --no-print-directory -j2 programs unit-tests $(B)/tests/sample/steps
	@$(MAKE) --no-print-directory -j2 config=sanitize programs unit-tests fuzz-replay
	@tests/run.sh

sanitize:
	@$(MAKE) --no-print-directory -j2 config=sanitize programs unit-tests fuzz-replay
	@tests/run.sh sanitize

lint:
	@tests/lint/lint.sh

format:
	@git ls-files --cached --others --exclude-standard '*.c' '*.h' '*.cc' | xargs clang-format -i

bench: $(patsubst $(B)/tests/bench/%_bench,bench-%,$(BENCH))
bench-stream bench-decode: bench-%: web programs
	@node tests/bench/$*_bench.mjs $(BENCH_ARGS)
bench-%: $(B)/tests/bench/%_bench programs
	@$< $(BENCH_ARGS)

SECONDS ?= 60
fuzz:
	@$(MAKE) --no-print-directory -j2 config=fuzz fuzz-replay
	@tests/fuzz/fuzz.sh $(SECONDS)

install: programs
	install -D -m 755 $(B)/lodestreamd $(DESTDIR)$(PREFIX)/bin/lodestreamd
	install -D -m 755 $(B)/lodestream $(DESTDIR)$(PREFIX)/bin/lodestream
	@if [ -d build/web ]; then mkdir -p $(DESTDIR)$(PREFIX)/share/lodestream && cp -R build/web $(DESTDIR)$(PREFIX)/share/lodestream/; fi

clean:
	rm -rf build
