// Unpack the page's program, and begin with it, here or in a worker.
const decode = (text) => Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)); // older browsers have no fromBase64
const unpack = async (id) => {
  const stream = new Blob([decode(document.getElementById(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
const parts = { code: unpack("code"), module: unpack("module"), data: unpack("data") }; // all at once
globalThis.unpacked = (id) => parts[id];
parts.code.then((program) => {
  globalThis.worker = () => new Worker(URL.createObjectURL(new Blob([program], { type: "text/javascript" })));
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(program); // whose hash the policy of the page has
  document.head.append(script);
});
