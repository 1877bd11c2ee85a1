// Opens links to the page, and says what each shows: node open.mjs CHROMIUM FOLDER_OF_NODE_MODULES ADDRESS... prints JSON.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [, , executablePath, modules, ...addresses] = process.argv;
const { chromium } = createRequire(`${modules}/`)("playwright-core");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const answers = [];
for (const address of addresses) {
  const page = await browser.newPage();
  const requests = [], errors = [];
  page.on("request", (request) => { if (!/^(data|blob):/.test(request.url())) requests.push(request.url()); });
  page.on("pageerror", (error) => errors.push(error.message));
  page.on("console", (message) => { if (message.type() === "error") errors.push(message.text()); });
  await page.goto(address);
  await page.waitForFunction(() => document.documentElement.dataset.ready === "true");
  await page.waitForTimeout(450); // the link and the command follow a moment after the picture
  const said = await page.getByRole("status").innerText();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "CSV" }).click()]);
  answers.push({
    requests, errors, said,
    command: await page.locator("#same").innerText(),
    cells: await page.locator("#numbers td").allInnerTexts(),
    pictures: await page.locator("figure > div > svg:has(path.line)").count(),
    hash: await page.evaluate(() => location.hash),
    table: readFileSync(await download.path(), "utf8"),
  });
  await page.close();
}
await browser.close();
console.log(JSON.stringify(answers));
