// Opens pages in Chromium and says what axe-core finds, what they load, and how their plots answer to the keyboard.
// node browser.mjs CHROMIUM FOLDER_OF_NODE_MODULES PAGE...   prints JSON: one record for each page, width and theme
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [, , executablePath, modules, ...pages] = process.argv;
const require = createRequire(`${modules}/`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const found = [];
for (const file of pages)
  for (const width of [1280, 390])
    for (const colorScheme of ["light", "dark"]) {
      const page = await browser.newPage({ viewport: { width, height: 800 }, colorScheme });
      const loads = [], errors = [];
      page.on("request", (request) => { if (!request.url().startsWith("file:")) loads.push(request.url()); });
      page.on("pageerror", (error) => errors.push(error.message));
      page.on("console", (message) => { if (message.type() === "error") errors.push(message.text()); }); // what the policy forbids, too
      await page.goto(pathToFileURL(file).href);
      // which takes most of the time: each width and each theme once
      const looked = (width === 1280) === (colorScheme === "light");
      if (looked) await page.evaluate(axe);
      const { violations } = looked ? await page.evaluate(() => axe.run()) : { violations: [] };
      const record = {
        file, width, colorScheme, loads, errors, looked,
        violations: violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 120)).join("; ")}`),
        wide: await page.evaluate(() => document.documentElement.scrollWidth),
      };
      record.pictures = await page.locator("[role=img]").evaluateAll((all) => all.map((of) => of.getAttribute("aria-label")));
      const slider = page.locator(".controls input").first();
      if (await slider.count()) {
        await slider.focus();
        for (let press = 0; press < 5; press++) await page.keyboard.press("ArrowRight");
        record.moment = await slider.getAttribute("aria-valuetext");
        record.readout = await page.locator(".readout").first().innerText();
        await page.keyboard.press("Tab");
        await page.keyboard.press("Enter");
        const times = page.locator(".plot").first().locator("text[text-anchor=middle][fill='var(--ink)']");
        record.zoomed = await times.evaluateAll((texts) => texts.map((of) => of.textContent));
        const [download] = await Promise.all([
          page.waitForEvent("download"), page.getByRole("button", { name: "Save drawn data" }).first().click(),
        ]);
        record.saved = readFileSync(await download.path(), "utf8").split("\n").slice(0, 3);
        await page.locator("#unit-mmol").check();
        record.units = await page.locator("table").first().innerText();
      }
      const person = page.locator("button[data-person]").first();
      if (await person.count()) {
        await person.press("Enter");
        record.chosen = await person.getAttribute("data-person");
        record.pressed = await person.getAttribute("aria-pressed");
        record.told = await page.locator(".worst .readout").first().innerText();
        const worst = page.locator(".worst .plot");
        const names = (opacity) => worst.locator(`path.line[stroke-opacity="${opacity}"] > title`).evaluateAll((titles) => titles.map((of) => of.textContent));
        record.clear = await names("1");
        await person.press("Enter");
        record.fadedAfter = (await names("0.08")).length;
      }
      const box = page.locator("input[data-run]").first();
      if (await box.count()) {
        await box.press("Space");
        record.left = await page.locator("path.line > title").evaluateAll((titles) => titles.map((of) => of.textContent));
      }
      if (looked) { // what a reader sees for whom no script runs
        const plain = await browser.newPage({ viewport: { width, height: 800 }, javaScriptEnabled: false });
        await plain.goto(pathToFileURL(file).href);
        record.plain = await plain.locator("noscript").allInnerTexts();
        record.plainLooks = await plain.locator(".controls:visible, .plot:visible, .legend:visible, .cvga:visible").count();
        await plain.close();
      }
      found.push(record);
      await page.close();
    }
await browser.close();
console.log(JSON.stringify(found));
