// What people look for first comes first: of all that is called `fit`, the recogniser's.
const FIRST = ["recognition.ObjectRecogniser", "recognition.Belief", "touches.Touches"];

var Scorer = {
  score: ([docname, , , , score]) =>
    score + Math.max(0, ...FIRST.map((name, at) => (docname.endsWith(name) ? 12 - at : 0))),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
