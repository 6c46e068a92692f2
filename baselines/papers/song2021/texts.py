"""What is told of the paper."""

CLAIMS = """\
A robot checks its GNSS position against dead reckoning (wheel encoders and the heading of an
inertial system). A jump is a drift above 1.5 m for two fixes in a row, a slow change a mean drift
above 1.28 m over five fixes; while either holds, GNSS is left out of the Kalman filter. On a court
of 13.4 m x 6.1 m, against jumps of 20 m and drifts of 0.5 m/s on both axes, this keeps the error at
about a metre, where a plain filter follows the attack and a distance constraint (RIO) notices the
drift after 26 s. The paper reports an accuracy rate of 100 % with the chosen windows, a jump found
after 2 s, a drift after 5 s.
"""

FINDINGS = """\
- The ordering of the algorithms holds in every run, except a few with both attacks and the largest
  error of the heading, in which RIO is worse than the plain filter. The rows of GNSS and of the
  plain filter are reproduced, but say little: they follow from the attack, the definition of sigma
  and one gain. Most figures of RIO's and ACNA's printed run are worse than ours under the jump
  (sigma 1.39 and 1.14 m, ours 0.87 m), ACNA's better under both attacks (0.81 m, ours 1.41 m), by
  more than the spread of single runs; a second program agrees with ours.
- ACNA is not better than RIO against the jump (1.14 m and 1.39 m in the paper): both reject it at
  once and rest on the same dead reckoning, and the difference is chance.
- The paper's result with both attacks (0.81 m, zeta 92.5 %) is not what its own flowchart gives;
  zeta = 1 - gamma / (gamma of GNSS), gamma the sigma under attack over the clean one. Dead
  reckoning drifts by more than the threshold during the jump, GNSS is locked out for good in most
  runs, and the median zeta is near 85 %. With an end of the exclusion it is about 94 %
  (`production`: fixes are held back while a jump is pending; a fix is accepted again after three in
  a row within a threshold that widens with the outage), and every run believes GNSS again.
- The jump is found at the first fix, not at the second: a single drift of 28 m lifts the mean of
  five above 1.28 m. The rule of two fixes then protects from nothing. `production` caps what a
  drift adds to the mean, so that it alarms at the second fix.
- 100 % accuracy contradicts any latency. It is met only if an alarm counts for its whole window
  afterwards, and pending fixes are not used.
- The paper's false-alarm rate is the rate of missed alarms, and the other way round. Ours are by
  their proper names.
- The thresholds need slowly changing GNSS errors. With white noise of the same clean accuracy they
  alarm on a large part of the clean fixes.
- Without an attack and with a heading that is off by 4 deg, 0.15 % of the fixes alarm in the
  literal detector, in rare runs for good, and 0.13 % in `production` (1000 runs of 300 s).
- A drift slower than gain times threshold (0.2 m/s, both axes together) raises no lasting alarm:
  the filter follows it.
"""

READINGS = """\
- sigma is the standard deviation of the east, north and horizontal error, about their means.
- Attacks act on east and north alike; epochs count from 1 s to 300 s; the first attacked fix is at
  151 s (51 s), and an alarm there is a latency of 1 s.
- GNSS: a Gauss-Markov error of 1.0 m an axis and 60 s, and white noise of 0.2 m, chosen for the
  clean 0.59 m and 0.53 m.
- Dead reckoning: a hard-iron error of the heading of 4 deg (in the table *Runs* also 2 and 6 deg),
  the only source of drift; the paper names none. The corners have a radius of 0.3 m.
- The paper's seven measurements (eq. 9): the east and north of dead reckoning enter as increments,
  the input of the prediction; its heading, with the hard-iron error, gives the direction of these;
  east and north of GNSS are the two measurements of the filter. The heights of both are left out,
  on a level court. With GNSS excluded, the paper's first four (eq. 10) are the prediction alone.
- Filter: the position alone, driven by dead reckoning, with a gain that settles at 0.16, chosen for
  the 3.9 m by which the paper's filter lags.
- Drift of GNSS: from the prediction of the filter. If dead reckoning ran free from the start, most
  clean fixes would alarm.
- RIO: more than 16.5 m from free dead reckoning (chosen for the 26 s), latched until a fix comes
  within 5 m of the estimate. This gives the equal rows of the paper's data sets 3 and 4.
- Values of tables 3 to 5 are means over runs, those of tables 6 and 7 medians.
- The error of the heading, the errors of GNSS, the gain and RIO's distance are calibrated, and so
  are the constants of `production`; all else follows.
"""
