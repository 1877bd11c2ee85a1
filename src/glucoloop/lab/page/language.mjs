// @ts-check
/** The language of the page, English. `glucoloop lab --language FILE` puts a module of the same form in the place of this one. */

export const language = "en";
/** Texts in the place of those of texts.mjs, by their names, of the same form; what is left out stays English. @type {object} */
export const own = {};
/** Sentences on patients, settings, faults and statuses, which come with the data, by the English ones. @type {Record<string, string>} */
export const sentences = {};
