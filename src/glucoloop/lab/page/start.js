// Unpack the page's scripts, give each the name by which others import it, and start the first.
globalThis.unpacked = async (id) => {
  const text = atob(document.getElementById(id).textContent);
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
unpacked("code").then((bytes) => {
  const { scripts, modules, first } = JSON.parse(new TextDecoder().decode(bytes));
  const put = (type, text) => {
    const script = document.createElement("script");
    script.type = type;
    script.textContent = text;
    document.head.append(script);
  };
  for (const script of scripts) put("text/javascript", script);
  const address = (code) => `data:text/javascript;charset=utf-8,${encodeURIComponent(code)}`;
  put("importmap", JSON.stringify({ imports: Object.fromEntries(Object.entries(modules).map(([name, code]) => [name, address(code)])) }));
  put("module", `import ${JSON.stringify(first)};`);
});
