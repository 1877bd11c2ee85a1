// @ts-check
/** The sensor: white noise, or a continuous glucose monitor with its settings; and the dead time of the readings. */

import { byId, choices, element, select, setSlider, slider, tell } from "../dom.mjs";
import { monitorSettings } from "../situation.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("./controls.mjs").Change} Change */

/** @param {Session} session @param {Change} change @returns {() => void} shows what the situation has */
export function sensorView(session, change) {
  const { data } = session;
  const list = select("sensor-kind");
  choices(list, [["", texts.noMonitor], ...Object.keys(data.monitors).map((name) => /** @type {[string, string]} */ ([name, name]))]);
  list.addEventListener("change", () =>
    change(list.value === "" ? { monitor: null } : { monitor: { name: list.value, settings: {} }, noise_variance: 0 }),
  );
  const noise = slider("noise", texts.noise, { least: 0, most: 20, step: 0.05 }, 0, (noise_variance) => change({ noise_variance }, "noise"));
  const late = slider("dead-time", texts.deadTime, { least: 0, most: 60, step: data.sample_time_min }, 0, (dead_time_min) =>
    change({ dead_time_min }, "dead time"),
  );
  byId("dead-time-box").replaceChildren(late);

  /** @param {string} setting @param {number | boolean | null} value */
  function put(setting, value) {
    const { monitor } = session.situation;
    if (monitor === null) return;
    const { [setting]: _, ...others } = monitor.settings;
    const usual = value === null || value === data.monitors[monitor.name].settings[setting].usual;
    change({ monitor: { ...monitor, settings: usual ? others : { ...others, [setting]: value } } });
  }

  /** Controls of a monitor. @param {string} name */
  function controls(name) {
    return Object.entries(data.monitors[name].settings).map(([setting, { usual, most }]) => {
      if (setting === "worn_min") {
        const made = element("input", { type: "number", min: "0", max: `${most}`, step: "5", "data-name": setting });
        made.addEventListener("change", () => put(setting, made.value === "" ? null : Number(made.value)));
        return element("label", {}, texts.worn, made);
      }
      const made = element("input", { type: "checkbox", "data-name": setting });
      made.addEventListener("change", () => put(setting, typeof usual === "boolean" ? made.checked : made.checked ? usual : 0));
      return element("label", { class: "check" }, made, typeof usual === "boolean" ? texts.parts[setting] : texts.lag(Number(usual)));
    });
  }

  /** The monitor whose controls are there; "" for white noise. @type {string | undefined} */
  let shown;
  return () => {
    const { monitor, noise_variance, dead_time_min } = session.situation;
    const name = monitor?.name ?? "";
    if (shown !== name) {
      shown = name;
      list.value = name;
      byId("sensor").replaceChildren(...(name === "" ? [noise] : controls(name)));
    }
    tell(byId("sensor-hint"), name === "" ? "" : data.monitors[name].summary);
    setSlider(noise, noise_variance);
    setSlider(late, dead_time_min);
    if (monitor === null) return;
    const settings = monitorSettings(monitor, data);
    for (const field of byId("sensor").querySelectorAll("input")) {
      const value = settings[field.dataset.name ?? ""];
      if (field.type === "checkbox") field.checked = Boolean(value);
      else if (field !== document.activeElement) field.value = value === null ? "" : `${value}`;
    }
  };
}
