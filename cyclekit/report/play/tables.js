// Plays with the sequences of the page. Optional: without it the page is complete, and this section stays hidden.
// The steps are those of cyclekit's `estimate`: the names say which function each part follows. The template puts
// these files into one function: tables, positions, lookup, often, walk, numbers, chart, controls.
const holder = document.getElementById("play-data");
if (!holder || typeof DecompressionStream === "undefined") return;
const told = JSON.parse(holder.textContent);
const facts = told.facts;
const words = facts.words;
const say = (key, values = {}) => words[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
const NOTHING = 1e-9;

// ---- the tables

const TYPES = {
  uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, float32: Float32Array,
};
const tables = {};

const unpack = async () => {
  const zipped = Uint8Array.from(atob(told.block), (letter) => letter.charCodeAt(0));
  const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("deflate"));
  const block = await new Response(stream).arrayBuffer();
  for (const [name, [type, offset, count]] of Object.entries(told.arrays)) {
    tables[name] = new TYPES[type](block, offset, count);
  }
  told.block = "";
};

let COUNT, SAMPLES, STEP_S, field;
const prepare = () => {
  COUNT = facts.tracks.count;
  SAMPLES = tables.people_cells.length / COUNT;
  STEP_S = facts.tracks.step_s;
  field = tables.scaling ? lookupField() : positionsField();
};
