// Plays with the sequences of the page. Optional: without it the page is complete, and this section stays hidden.
// The steps are those of cyclekit's `estimate`: the names say which function each part follows. The template puts
// these files into one function: tables, positions, lookup, often, walk, numbers, chart, controls.
const holder = document.getElementById("play-data");
if (!holder || typeof DecompressionStream === "undefined") return;
const told = JSON.parse(holder.textContent);
const { words } = told;
const say = (key, values = {}) => words[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
const NOTHING = 1e-9;

// ---- the tables

const TYPES = {
  uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, int32: Int32Array, float32: Float32Array,
};
// of the sequences that are played now: all those of one kind share them
let facts = told.parts[0].facts;
let tables, COUNT, SAMPLES, STEP_S, field;

const unpack = async (part) => {
  const zipped = Uint8Array.from(atob(part.block), (letter) => letter.charCodeAt(0));
  const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("deflate"));
  const block = await new Response(stream).arrayBuffer();
  part.tables = {};
  for (const [name, [type, offset, count]] of Object.entries(part.arrays)) {
    part.tables[name] = new TYPES[type](block, offset, count);
  }
  const { who } = part.tables; // number of the position, or of the state, of each sample of each track; as steps, which wrap
  if (who) for (let at = 1; at < who.length; at += 1) who[at] += who[at - 1];
  part.block = "";
};

const enter = (part) => {
  ({ facts, tables } = part);
  if (facts.kind === "list") return;
  COUNT = facts.tracks.count;
  SAMPLES = tables.who.length / COUNT;
  STEP_S = facts.tracks.step_s;
  part.field = part.field || (tables.nodes ? gridField() : tables.scaling ? lookupField() : positionsField());
  field = part.field;
};
