"use strict";
// Runs the firmware's C, compiled to WebAssembly, away from the page: codes in, drift and flags out.
(function () {
  const block = 4096; // steps in one call; bounds the memory
  let chip = null;
  function align(at) { return Math.ceil(at / 16) * 16; }
  async function open(told) {
    const { instance } = await WebAssembly.instantiate(told.wasm, {});
    const c = instance.exports, columns = told.columns, outputs = told.outputs, bytes = told.code_bytes;
    const state = align(c.__heap_base.value);
    const codes = align(state + c.zd_state_size()), drift = align(codes + block * columns * bytes);
    const flags = align(drift + block * outputs * 4), packed = align(flags + block * 4);
    const room = packed + 8 * c.zd_state_size() + 1024; // a number for each byte of the state, and more
    const lacks = room - c.memory.buffer.byteLength;
    if (lacks > 0) { c.memory.grow(Math.ceil(lacks / 65536)); }
    chip = { c, state, codes, drift, flags, packed, width: columns * bytes, outputs };
    return { fault: c.zd_selftest(), state_bytes: c.zd_state_size() };
  }
  function put(codes) { new Uint8Array(chip.c.memory.buffer).set(codes, chip.codes); }
  function start(told) {
    put(new Uint8Array(told.codes, 0, chip.width));
    chip.c.zd_start(chip.state, chip.codes, told.settled ? 1 : 0);
    if (told.elapsed) { chip.c.zd_elapse(chip.state, told.elapsed); }
    return {};
  }
  // `chunk` > 0: the whole state after so many steps each time, too.
  function run(told) {
    const given = new Uint8Array(told.codes), steps = given.length / chip.width;
    const drift = new Int32Array(steps * chip.outputs), flags = new Uint32Array(steps), packed = [];
    let milliseconds = 0;
    for (let first = 0; first < steps;) {
      const most = Math.min(block, steps - first, told.chunk ? told.chunk - (first % told.chunk) : block);
      put(given.subarray(first * chip.width, (first + most) * chip.width));
      const begun = performance.now();
      chip.c.zd_run(chip.state, chip.codes, most, chip.drift, chip.flags, 0);
      milliseconds += performance.now() - begun;
      const memory = chip.c.memory.buffer;
      drift.set(new Int32Array(memory, chip.drift, most * chip.outputs), first * chip.outputs);
      flags.set(new Uint32Array(memory, chip.flags, most), first);
      first += most;
      if (told.chunk && (first % told.chunk === 0 || first === steps)) {
        const count = chip.c.zd_pack(chip.state, chip.packed);
        packed.push(memory.slice(chip.packed, chip.packed + 8 * count));
      }
    }
    return { drift, flags, packed, milliseconds };
  }
  const does = { open, start, run };
  self.onmessage = async function (event) {
    const told = event.data;
    try {
      const found = await does[told.what](told);
      self.postMessage({ id: told.id, ...found }, found.drift ? [found.drift.buffer, found.flags.buffer] : []);
    } catch (error) {
      self.postMessage({ id: told.id, error: String(error) });
    }
  };
})();
