// Unpack the page's program, and begin with it, here or in a worker.
const unpack = async (id) => {
  const text = atob(document.getElementById(id).textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
const parts = { code: unpack("code"), module: unpack("module"), data: unpack("data") }; // all at once
globalThis.unpacked = (id) => parts[id];
parts.code.then((bytes) => {
  const { drawing, program } = JSON.parse(new TextDecoder().decode(bytes));
  const start = (name) => `${program}need("${name}").start();`;
  globalThis.worker = () => new Worker(URL.createObjectURL(new Blob([start("worker")], { type: "text/javascript" })));
  for (const text of [drawing, `{${start("main")}}`]) {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
  }
});
