// Opens pages in Chromium and says what they show: node browse.mjs CHROMIUM HOME ADDRESS... It speaks DevTools' protocol
// through pipes, so that it needs nothing but node. The answer is a JSON list on standard output.
import { spawn } from "node:child_process";

const PATIENCE_MS = 120_000;
const [program, home, ...addresses] = process.argv.slice(2);
const options = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", `--user-data-dir=${home}`];
const browser = spawn(program, options, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
const [, , , into, from] = browser.stdio;

let last = 0;
const waiting = new Map();
const events = [];
let rest = "";
from.on("data", (bytes) => {
  const texts = (rest + bytes).split("\0");
  rest = texts.pop();
  for (const text of texts) {
    const message = JSON.parse(text);
    if (message.id === undefined) events.push(message);
    else waiting.get(message.id)(message.result ?? message.error);
  }
});

function call(method, params = {}, sessionId = undefined) {
  last += 1;
  into.write(`${JSON.stringify({ id: last, method, params, sessionId })}\0`);
  return new Promise((resolve) => waiting.set(last, resolve));
}

async function shown(address) {
  events.length = 0;
  const { targetId } = await call("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await call("Target.attachToTarget", { targetId, flatten: true });
  for (const domain of ["Page", "Runtime", "Network", "Log"]) await call(`${domain}.enable`, {}, sessionId);
  await call("Page.navigate", { url: address }, sessionId);
  const ask = async (expression) => (await call("Runtime.evaluate", { expression }, sessionId)).result.value;
  const end = Date.now() + PATIENCE_MS;
  while (!(await ask("document.documentElement.dataset.ready"))) {
    if (Date.now() > end) break;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  const text = (selector) => ask(`document.querySelector(${JSON.stringify(selector)}).textContent`);
  const cells = await ask(`JSON.stringify([...document.querySelectorAll("#numbers td")].map((cell) => cell.textContent))`);
  const of = (name) => events.filter((event) => event.method === name).map((event) => event.params);
  const answer = {
    ready: (await ask("document.documentElement.dataset.ready")) === "true",
    said: await text("#said"),
    same: await text("#same"),
    cells: JSON.parse(cells),
    canvases: await ask('document.querySelectorAll("canvas").length'),
    hash: await ask("location.hash"),
    errors: [...of("Runtime.exceptionThrown"), ...of("Log.entryAdded")].map((params) => JSON.stringify(params)),
    requests: of("Network.requestWillBeSent")
      .map((params) => params.request.url)
      .filter((url) => !url.startsWith("data:")),
  };
  await call("Target.closeTarget", { targetId });
  return answer;
}

const answers = [];
for (const address of addresses) answers.push(await shown(address));
console.log(JSON.stringify(answers));
browser.kill();
