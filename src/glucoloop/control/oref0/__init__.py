"""oref0 0.7.1, the dosing of OpenAPS: temporary basal rates and microboluses by four forecasts of glucose.

Written from the published algorithm as equations on arrays; results are rounded wherever the original rounds.

============ ================================================ ========================================================
module       original                                         computes
============ ================================================ ========================================================
`inputs`     ``glucose-get-last.js``                          the reading, and its change over 5, 15 and 40 min
             ``iob/calculate.js``, ``total.js``, ``index.js`` insulin on board and its activity, now and for four hours
             ``determine-basal/cob.js``, ``meal/total.js``    carbohydrate on board, from deviations
`forecast`   ``determine-basal/determine-basal.js``, first    predicted glucose: IOB, COB, UAM and ZT
`dose`       ``determine-basal/determine-basal.js``, second   the temporary basal rate and the microbolus
             ``basal-set-temp.js``, ``round-basal.js``        limits of a temporary basal rate
`records`    the arguments of ``determine_basal``
`controller`                                                  the controller of glucoloop that holds the histories
============ ================================================ ========================================================

References
----------
D. M. Lewis, S. Leibrand, "Real-world use of open source artificial pancreas systems", J. Diabetes Sci. Technol. 10(6),
2016, 1411. The program: npm package ``oref0`` 0.7.1 (MIT), https://github.com/openaps/oref0.
"""
