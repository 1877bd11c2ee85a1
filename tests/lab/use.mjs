// Uses the page as people do, and says what it shows: node use.mjs CHROMIUM FOLDER_OF_NODE_MODULES PAGE FILES... prints JSON.
// FILES are results to load: a table and a configuration of a run, and the page of a trial.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [, , executablePath, modules, file, table, configuration, trial] = process.argv;
const require = createRequire(`${modules}/`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const address = pathToFileURL(file).href;

async function open(hash, options = {}) {
  const page = await browser.newPage({ viewport: { width: 1280, height: 900 }, ...options });
  const seen = { loads: [], errors: [] };
  page.on("request", (request) => {
    if (!/^(data|blob):/.test(request.url())) seen.loads.push(request.url());
  });
  page.on("pageerror", (error) => seen.errors.push(error.message));
  page.on("console", (message) => { if (message.type() === "error") seen.errors.push(message.text()); }); // what the policy forbids, too
  await page.goto(address + hash);
  await page.waitForFunction(() => document.documentElement.dataset.ready);
  return { page, seen };
}
// The link and the controls follow a moment later, by timers of the page one after the other. These begin after those
// and wait at least as long, so that they end after them on a busy computer too.
const drawn = (page) =>
  page.evaluate(async () => {
    for (let frame = 0; frame < 2; frame++) await new Promise((done) => requestAnimationFrame(done));
    for (let timer = 0; timer < 3; timer++) await new Promise((done) => setTimeout(done, 270));
  });
const of = (page, selector) => page.locator(selector).innerText();
const hash = (page) => page.evaluate(() => new URLSearchParams(location.hash.slice(1)).get("meals"));

const views = [];
for (const width of [1280, 390])
  for (const colorScheme of ["light", "dark"]) {
    const lesson = "#controller=mpc&guard=usual&faults=occlusion,+start_min=30,+duration_min=120";
    const hash = colorScheme === "dark" ? lesson : "#controller=mpc&guard=usual&sensor=white-noise,+variance=1.45";
    const { page, seen } = await open(hash, { viewport: { width, height: 844 }, colorScheme });
    for (const details of await page.locator("details:visible > summary").all()) await details.click();
    await page.locator("#pin").click();
    await page.locator("#moment").press("ArrowRight");
    await drawn(page);
    const looked = (width === 1280) === (colorScheme === "light"); // which takes most of the time
    if (looked) await page.evaluate(axe);
    const { violations } = looked ? await page.evaluate(() => axe.run()) : { violations: [] };
    views.push({
      width, colorScheme, looked, ...seen,
      violations: violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 120)).join("; ")}`),
      wide: await page.evaluate(() => document.documentElement.scrollWidth),
      chosen: await page.evaluate(() => {
        const lesson = document.querySelector("#lessons [aria-current]");
        if (lesson === null) return "none";
        const [row, own] = [document.getElementById("lessons"), lesson].map((element) => element.getBoundingClientRect());
        return own.left >= row.left && own.right <= row.right ? "seen" : "hidden";
      }),
    });
    await page.close();
  }

const { page, seen } = await open("");
const used = {};
// Every control is reached by the tabulator, and has a name.
used.controls = await page.locator("a[href]:visible, button:enabled:visible, input:visible, select:visible, summary:visible").count();
const reached = new Set();
await page.evaluate(() => /** @type {HTMLElement} */ (document.activeElement).blur());
for (let press = 0; press < 3 * used.controls; press++) {
  await page.keyboard.press("Tab");
  const at = await page.evaluate(() => {
    const all = [...document.querySelectorAll("a[href], button, input, select, summary")];
    return all.indexOf(document.activeElement);
  });
  if (at >= 0) reached.add(at);
}
used.reached = reached.size;
const mark = page.locator(".mark").first();
await mark.press("ArrowRight");
await mark.press("ArrowUp");
await drawn(page);
used.byKeys = [await hash(page), await mark.getAttribute("aria-label")];
const box = await mark.boundingBox();
await page.mouse.move(box.x + 8, box.y + 8);
await page.mouse.down();
await page.mouse.move(box.x + 108, box.y - 32, { steps: 4 });
await page.mouse.up();
await drawn(page);
used.dragged = await hash(page);
await page.locator("#undo").click();
await drawn(page);
used.undone = await hash(page);
await page.locator("#moment").press("Home");
for (let press = 0; press < 14; press++) await page.locator("#moment").press("ArrowRight");
await drawn(page);
used.moment = await page.locator("#moment").getAttribute("aria-valuetext");
used.why = await of(page, "#why");
await page.locator("#glucose-unit").selectOption("mmol/l");
await page.locator("#insulin-unit").selectOption("U/h");
await drawn(page);
used.units = [await of(page, "#number-names"), await of(page, "#why"), await page.evaluate(() => location.hash)];
used.saved = {};
for (const kind of ["csv", "svg", "png"]) {
  const [download] = await Promise.all([page.waitForEvent("download"), page.locator(`#save-${kind}`).click()]);
  used.saved[download.suggestedFilename()] = readFileSync(await download.path()).subarray(0, 200_000).toString("latin1");
}
await page.locator("#form").selectOption("python");
used.python = await of(page, "#same");
await page.locator("#people-try").click();
await page.waitForFunction(() => !document.querySelector("#people-box").hidden, null, { timeout: 120_000 });
await page.locator("#people-harmed button").first().click();
await drawn(page);
used.followed = await page.evaluate(() => location.hash);
used.people = [await of(page, "#said"), await of(page, "#people-points"), await page.locator("#people-harmed button").count(), await of(page, "#numbers")];
await page.evaluate(axe);
used.peopleViolations = (await page.evaluate(() => axe.run())).violations.map(({ id }) => id);
const bands = async () => {
  const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#save-svg").click()]);
  return readFileSync(await download.path(), "utf8").split("<path class=\"area\"").length - 1;
};
used.bands = [await bands()];
const before = await page.locator("#controller").inputValue();
for (const controller of [before === "imc" ? "pid" : "imc", before]) {
  await page.locator("#controller").selectOption(controller);
  await drawn(page);
  used.bands.push(await bands());
}
await page.locator("#people-clear").click();
await page.locator("#numbers button").first().click();
await page.locator("#load-box summary").click();
await page.setInputFiles("#load", [table, configuration]);
await drawn(page);
used.run = [await of(page, "#said"), await page.locator("#numbers tr").count()];
await page.setInputFiles("#load", [trial]);
await drawn(page);
used.trial = [await of(page, "#said"), await page.locator("#loaded-cases button").allInnerTexts()];
await page.setInputFiles("#load", [file]);
await drawn(page);
used.foreign = await of(page, "#said");
await page.setInputFiles("#load", [{ name: "people.parquet", mimeType: "application/octet-stream", buffer: Buffer.from("PAR1") }]);
await drawn(page);
used.parquet = await of(page, "#said");
await page.evaluate(() => { location.hash = "#controller=fuzzy"; });
await drawn(page);
used.nonsense = await of(page, "#said");
await page.locator("#controller").selectOption("pid");
await drawn(page);
used.after = await of(page, "#said");
await page.locator("#insulin-unit").selectOption("mU/min");
const preset = page.locator("#presets a", { hasText: "subcutaneous insulin" });
await preset.evaluate((link) => link.click());
await drawn(page);
await page.locator("#people-try").click();
await page.waitForFunction(() => !document.querySelector("#people-box").hidden, null, { timeout: 120_000 });
used.skin = [await of(page, "#insulin-title"), await of(page, "#people-hint"), await of(page, "#said")];
await page.locator("#family").selectOption("parker-1999");
await drawn(page);
used.gone = await of(page, "#said");
await page.locator("#point").selectOption("nominal-22");
await drawn(page);
await page.locator("#people-try").click();
used.elsewhere = [await of(page, "#people-hint"), await of(page, "#said")];
for (const [family, key] of [["uva-padova-2008", "u"], ["kanderian-2009", "End"]]) {
  await page.locator("#family").press(key);
  await drawn(page);
  await page.locator("#form").selectOption("people");
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  used[family] = [await page.locator("#family").inputValue(), await of(page, "#insulin-title"), await of(page, "#insulin-legend"), await of(page, "#people-hint"), await of(page, "#same"), wide];
}
used.seen = seen;
await browser.close();
console.log(JSON.stringify({ views, used }));
