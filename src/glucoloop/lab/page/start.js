// Unpack the page's program, and begin with it, here or in a worker.
globalThis.unpacked = async (id) => {
  const text = atob(document.getElementById(id).textContent);
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
unpacked("code").then((bytes) => {
  const { drawing, program } = JSON.parse(new TextDecoder().decode(bytes));
  const start = (name) => `${program}need("${name}").start();`;
  globalThis.worker = () => new Worker(URL.createObjectURL(new Blob([start("worker")], { type: "text/javascript" })));
  for (const text of [drawing, `{${start("main")}}`]) {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
  }
});
