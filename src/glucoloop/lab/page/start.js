// Unpack the page's program, and begin with it, here or in a worker.
const decode = (text) => Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)); // older browsers have no fromBase64
const unpack = async (id) => {
  const stream = new Blob([decode(document.getElementById(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
const parts = { code: unpack("code"), module: unpack("module"), data: unpack("data") }; // all at once
globalThis.unpacked = (id) => parts[id];
parts.code.then((bytes) => {
  const program = new TextDecoder().decode(bytes);
  const start = (name) => `{${program}need("${name}").start();}`;
  globalThis.worker = () => new Worker(URL.createObjectURL(new Blob([start("worker")], { type: "text/javascript" })));
  const script = document.createElement("script");
  script.textContent = start("main");
  document.head.append(script);
});
