// Unpack the page's program, and begin with it, here or in a worker.
const digits = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`.|}~";
const values = new Uint8Array(128).map((_, code) => digits.indexOf(String.fromCharCode(code)));
/** Bytes of Base85: five digits are a whole number of four bytes. */
const decode = (text) => {
  const result = new DataView(new ArrayBuffer(4 * Math.ceil(text.length / 5)));
  for (let i = 0; i < text.length; i += 5) {
    let number = 0;
    for (let j = i; j < i + 5; j++) number = 85 * number + (j < text.length ? values[text.charCodeAt(j)] : 84);
    result.setUint32((4 * i) / 5, number);
  }
  return new Uint8Array(result.buffer, 0, Math.floor((4 * text.length) / 5));
};
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
