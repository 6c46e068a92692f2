"""What the paper claims, what we found, and how we read it."""

TITLE = "Ke et al. (2022)"

CLAIMS = """\
A tightly coupled receiver monitors the rate of each satellite's normalized innovation, found by
a small Kalman filter (M1).  The same rate weighs the satellite in the navigation filter by
IGG-III (M2), which keeps the spoofing out of the position and of the other channels'
innovations.  Two further methods, M3 for small steps and M4 for slow ramps, put the spoofing
offset into the normalized innovation; they are said to detect 51.9 % sooner on average and to
miss nothing where M2 misses 74 % (small steps) and 42 % (slow ramps), with false alarms near
zero.
"""

FINDINGS = """\
- **M2's detection times are reproduced.**  All nine of Fig. 8 lie within 20 % or 1.5 s of the
  paper (medians of 50 runs), and so do ten of the twelve in the three-channel figures 6 and 7; the
  other two are 2 s shorter than the printed 9 s.
- **The weights do what is claimed.**  Under the three-channel step the plain filter alarms on the
  unspoofed channels 4 to 6 in every run.  With weights and without satellite biases none of the
  unspoofed channels alarms, and the position error is a sixth of the plain filter's.  With the
  constant biases of the simulator 8 to 36 % of the runs alarm on channels 4 to 6; and under the
  three-channel ramp channel 4 alarms in most runs, with or without biases.  The paper's 1 to 3 % is
  met only for the step, and only without biases; and only there is the error below a quarter of the
  plain filter's, with biases it is 0.3 to the north and 0.6 to the east.
- **M3 and M4 are no detectors.**  They are given the channel, the size and the onset, and count
  the offset twice: M3 at 10 m is M2 at 20 m, and so on, in the paper's numbers and in ours.
  Told of an attack where nothing is spoofed, they alarm in all runs without biases.  With
  biases they alarm in all runs if told 10 m or 0.1 m/s, in 96 % if told 0.05 m/s, and in 74 %
  if told 5 m.  Told the wrong channel, they accuse it.
- **The misses of tables 6 and 8 depend on the satellite.**  With constant biases M2 misses 5 m
  in 4 to 66 % of the runs and 0.05 m/s in 0 to 72 %, depending on the satellite; without biases
  it misses none, except on S11, whose redundancy is low: 66 and 74 %.  The printed 74 % and
  42 % are within three standard errors of that range, which is so wide that it says little.
- **The position errors of Figs. 9b and 10b are those of one run.**  The printed 1.0 to 1.2 m to the
  north and 1.3 to 1.4 m to the east lie among our single runs with constant biases, whose medians
  are 3.1 and 2.7 m; with white noise alone ours are half of the printed ones.
- **The paper contradicts itself** at 0.05 m/s: M2 takes 157 s in Fig. 8 and 147 s in Fig. 10.  Its
  saving of 41.5 % goes with the latter.
- **Tests that do not know the attack do better.**  A likelihood-ratio scan over all onsets with
  an unknown baseline, or a CUSUM against the innovation's own past, finds 10 m in 3 to 5 s,
  where M3 takes 8 s, and 5 m in 14 to 19 s, where it takes 19 s, and misses no run; ramps of
  0.1 m/s in 53 to 62 s and of 0.05 m/s in 93 to 108 s, sooner than M2, if later than M4 with
  its 50 and 81 s.  On clean flights neither had a false alarm in 50 runs, with or without
  constant biases.
- **The printed threshold is a frozen variance.**  It is the adaptive threshold after 329
  samples, and with a filter that starts at 20 s that is the onset of the attack.  Later the
  filter is surer and the constant too large; the adaptive threshold is sooner by a fifth to a
  third at slow ramps, needs no settling time, and is our default.
"""

READINGS = """\
- Accelerometer errors are micro-g (the printed mg would drift 149 km in the flight); 2.5 m is
  the noise that the filter assumes, while the simulated noise is 1 m and constant biases of
  satellites, as in the software that the paper builds on.  Rows marked *no biases* have only
  the white noise.
- The flight lasts 746 s at 200 m/s with two turns of 45 deg and climbs; their times are our
  choice.
- Channels are the satellites in view in the order of their ids: channel 3 is S09.
- The matrix of the rate filter is that of a differential equation, integrated over the
  interval; as a matrix from epoch to epoch it has no gain.  R is 1 and all four first variances
  are 1.
- The rate filter starts at 20 s, alarms and weights at 200 s; neither is stated.  20 s was chosen
  because it comes closest (of about 32 settings that were tried).
- The test is two-sided.  Range rates keep weight 1.  The covariance is updated with the
  unweighted gain; the two other forms change no median by more than a second.
- The paper's methods have no guard against lock-out; `M2 adaptive` has it, and the adaptive
  threshold, and starts at once.
- A step is there at 350 s; a ramp starts then.  A miss has no alarm until 550 s, and counts as
  longer than all others in a median.
- Table 6 is read as 5 m and table 8 as 0.05 m/s; the paper does not say.
"""
