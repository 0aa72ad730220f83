"""Encodings and classifiers of the user's own, feature vectors and data frames."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.decomposition import PCA
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import FeatureUnion, make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.svm import LinearSVC

from palpate import Touches
from palpate.classifiers import EncodingPool, KernelDensityBayes, KernelRidgeClassifier
from palpate.recognition import ModelFileError, ObjectRecogniser


class Means(TransformerMixin, BaseEstimator):
    """Encode images by their column means, times a factor."""

    def __init__(self, factor=1.0):
        self.factor = factor

    def fit(self, X, y=None):
        self.middle_ = np.asarray(X, float).mean()
        return self

    def transform(self, X):
        return self.factor * (np.asarray(X, float) - self.middle_).mean(axis=1)


class Changed(Means):
    """An encoding whose features are changed by a function."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def transform(self, X):
        return self.change(super().transform(X))


NAMES = ["ball", "mug", "pen"]


def drawn(n_each=14, seed=0):
    rng = np.random.default_rng(seed)
    patterns = np.random.default_rng(7).normal(size=(3, 5, 9))
    images = np.repeat(patterns, n_each, axis=0)
    images = images + 0.7 * rng.normal(size=images.shape)
    return Touches(images, object=np.repeat(NAMES, n_each), geometry="array")


@pytest.fixture(scope="module")
def touches():
    return drawn()


@pytest.fixture(scope="module")
def alone(touches):
    encodings = {"means": Means(2.0), "levels": [Means(), StandardScaler(), PCA(3)]}
    return ObjectRecogniser(None, encodings=encodings).fit(touches)


def test_encodings_of_the_user_join_the_pool(touches):
    plain = ObjectRecogniser().fit(touches)
    joined = ObjectRecogniser(encodings={"means": Means()}).fit(touches)
    added = set(joined.encoder_.encodings_) - set(plain.encoder_.encodings_)
    assert added == {"means"}
    assert joined.score(drawn(seed=1)) > 0.8


def test_encodings_of_the_user_may_stand_alone(alone):
    assert list(alone.encoder_.encodings_) == ["means", "levels"]
    assert set(alone.chosen_["weights"]) == {"means", "levels", "all together"}
    assert alone.memory_.features.shape[1] == 9 + 3
    assert alone.score(drawn(seed=1)) > 0.6
    assert alone.start().update(drawn(seed=2)[:9]).best == "ball"


def test_another_classifier_takes_the_place_of_the_pool(touches):
    learnt = ObjectRecogniser(classifier=LinearDiscriminantAnalysis()).fit(touches)
    assert learnt.score(drawn(seed=1)) > 0.7
    ours = ObjectRecogniser(classifier=KernelRidgeClassifier()).fit(touches)
    assert isinstance(ours.classifier_, KernelRidgeClassifier)


class NearestMean(KernelDensityBayes):
    """A classifier of the user's own that keeps the protocol by its base."""

    def fit(self, X, y, groups=None):
        self.classes_ = np.unique(y)
        self.means_ = np.stack([np.mean(X[y == c], axis=0) for c in self.classes_])
        self.touches_ = np.asarray(X)
        return self

    refit = fit

    def log_likelihood(self, X):
        return -((np.asarray(X)[:, None] - self.means_) ** 2).sum(axis=2)

    def left_out_log_likelihood(self):
        return self.log_likelihood(self.touches_)


def test_a_touch_classifier_of_the_user_gives_the_whole_belief(touches):
    learnt = ObjectRecogniser(None, encodings={"m": Means()}, classifier=NearestMean())
    learnt.fit(touches)
    features = learnt.encoder_.transform(drawn(seed=1))
    expected = learnt.classifier_.log_likelihood(features)
    assert_allclose(learnt.log_likelihood(drawn(seed=1)), expected)
    episode = learnt.episode(strangers=0, error=0.05)
    for touch in drawn(seed=3)[:14]:
        episode.add(touch)
    assert episode.decision == "ball"


@pytest.mark.parametrize(
    ("parameters", "kind", "message"),
    [
        ({"encodings": [Means()]}, TypeError, "encodings must map names"),
        ({"encodings": {"m": Means}}, TypeError, "must be a transformer with fit"),
        (
            {"encodings": {"m": [Means(), LinearDiscriminantAnalysis()]}},
            TypeError,
            r"encodings\['m'\] must learn without labels, got LinearDiscriminant",
        ),
        ({"encodings": {"": Means()}}, ValueError, "must have texts as names"),
        ({"encodings": {"m": []}}, ValueError, "a transformer each"),
        ({"encodings": {"taxels": Means()}}, ValueError, "'taxels', which is one of"),
        ({"preset": None}, ValueError, "at least one encoding with preset=None"),
        (
            {"preset": "liu2014", "encodings": {"m": Means()}},
            ValueError,
            "must be None with the preset 'liu2014'",
        ),
        ({"preset": "nothing"}, ValueError, "'default'"),
        ({"presentation": "upright"}, ValueError, "must be one of 'auto', 'any'"),
        (
            {"preset": "corradi2015", "presentation": "any"},
            ValueError,
            "presentation must be 'auto' with the preset",
        ),
        (
            {"preset": "liu2014", "presentation": "any"},
            ValueError,
            "presentation must be 'auto' with the preset",
        ),
        ({"floor": 2.0}, ValueError, "floor must be finite and between 0"),
        ({"random_state": -1}, ValueError, "random_state must be at least 0, got -1"),
        ({"random_state": 1.5}, TypeError, "must be an integer, got float"),
        ({"classifier": LinearSVC()}, TypeError, "have predict_proba"),
        ({"classifier": EncodingPool}, TypeError, "Give an instance"),
    ],
)
def test_parameters_that_cannot_be_are_refused(touches, parameters, kind, message):
    recogniser = ObjectRecogniser(**parameters)
    with pytest.raises(kind, match=message):
        recogniser.fit(touches)
    assert not hasattr(recogniser, "memory_")


FLAWS = {
    "nan": (lambda v: np.where(np.eye(*v.shape), np.nan, v), "give finite features"),
    "rows": (lambda v: v[:-1], "give 42 rows"),
    "images": (lambda v: v[:, np.newaxis], r"give numbers \(n_touches, n_features\)"),
    "neighbours": (
        lambda v: v - v.mean(axis=0),
        "encode a touch alone, as it did among others",
    ),
    "width": (
        lambda v: v if len(v) == 42 else v[:, :3],
        "give 9 features, as when it was learnt, got 3",
    ),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_an_encoding_that_breaks_a_rule_leaves_nothing_half_learnt(touches, flaw):
    change, message = FLAWS[flaw]
    recogniser = ObjectRecogniser(encodings={"m": Changed(change)})
    with pytest.raises(ValueError, match=rf"encodings\['m'\] must {message}"):
        recogniser.fit(touches)
    assert not hasattr(recogniser, "memory_")


def test_an_encoding_of_foreign_code_is_given_again(alone, tmp_path):
    path = alone.save(tmp_path / "m.palpate")
    with pytest.raises(ModelFileError, match="'means', which is code of its user"):
        ObjectRecogniser.load(path)
    encodings = {"means": Means(2.0), "levels": [Means(), StandardScaler(), PCA(3)]}
    again = ObjectRecogniser.load(path, encodings=encodings)
    test = drawn(seed=1)
    assert_array_equal(again.predict_log_proba(test), alone.predict_log_proba(test))
    clone(again).fit(drawn())
    # Steps that the file holds need not be given, and may be.
    ObjectRecogniser.load(path, encodings=encodings | {"means": [Means(2.0), PCA(2)]})


def test_a_pipeline_is_kept_as_its_steps_and_a_union_is_given_as_it_was_fitted(
    touches, tmp_path
):
    """What a pipeline has learnt is in its steps, where no file looks for it."""
    pipeline = make_pipeline(Means(), "passthrough", make_pipeline(StandardScaler()))
    own = {"steps": [pipeline, PCA(3)], "union": FeatureUnion([("means", Means(2.0))])}
    learnt = ObjectRecogniser(None, encodings=own).fit(touches)
    path = learnt.save(tmp_path / "m.palpate")
    with pytest.raises(ModelFileError, match=r"\['union'\] must be as it was learnt"):
        ObjectRecogniser.load(path, encodings=own)
    fitted = learnt.encoder_.encodings_["union"][0].steps_
    again = ObjectRecogniser.load(path, encodings=own | {"union": fitted})
    assert_array_equal(again.predict_proba(touches), learnt.predict_proba(touches))


def test_foreign_code_may_call_something_stored(touches, tmp_path):
    named = type("Named", (Means,), {"stored": "in a cupboard"})
    learnt = ObjectRecogniser(encodings={"means": named()}).fit(touches)
    path = learnt.save(tmp_path / "m.palpate")
    again = ObjectRecogniser.load(path, encodings={"means": named()})
    assert_array_equal(again.predict_proba(touches), learnt.predict_proba(touches))


@pytest.mark.parametrize(
    ("encodings", "message"),
    [
        ({"means": Means(3.0)}, "as it did when it was learnt"),
        ({"means": PCA(2)}, "must have a Means as step 1.* got PCA"),
    ],
)
def test_another_encoding_than_the_learnt_one_is_refused(
    alone, tmp_path, encodings, message
):
    path = alone.save(tmp_path / "m.palpate")
    levels = {"levels": [Means(), StandardScaler(), PCA(3)]}
    with pytest.raises(ModelFileError, match=message):
        ObjectRecogniser.load(path, encodings=encodings | levels)


def test_palpates_own_encodings_travel_in_the_file(touches, tmp_path):
    from palpate.encodings import GridLevels, PrincipalShare

    encodings = {"fine levels": [GridLevels(blur=0.5), PrincipalShare(0.9)]}
    learnt = ObjectRecogniser(None, encodings=encodings).fit(touches)
    again = ObjectRecogniser.load(learnt.save(tmp_path / "m.palpate"))
    assert_array_equal(again.predict_proba(touches), learnt.predict_proba(touches))
    assert "fine levels" in again.encoder_.encodings_


def test_a_classifier_of_foreign_code_cannot_be_written(touches, tmp_path):
    learnt = ObjectRecogniser(classifier=LinearDiscriminantAnalysis()).fit(touches)
    with pytest.raises(ModelFileError, match=r"hold a LinearDisc.* fit again"):
        learnt.save(tmp_path / "m.palpate")
    assert not list(tmp_path.iterdir())


def test_a_network_travels_in_the_model_file(touches, tmp_path):
    pytest.importorskip("onnxruntime")
    onnx = pytest.importorskip("onnx")
    from palpate.encodings import OnnxEncoding

    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("Flatten", ["x"], ["out"])],
        "g",
        [helper.make_tensor_value_info("x", kind, ("n", 1, 5, 9))],
        [helper.make_tensor_value_info("out", kind, ("n", 45))],
    )
    opset = [helper.make_opsetid("", 17)]
    file = tmp_path / "net.onnx"
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(file))
    learnt = ObjectRecogniser(None, encodings={"net": OnnxEncoding(file)}).fit(touches)
    path = learnt.save(tmp_path / "m.palpate")
    file.unlink()
    again = ObjectRecogniser.load(path)
    test = drawn(seed=1)
    assert_array_equal(again.predict_log_proba(test), learnt.predict_log_proba(test))
    assert again.score(test) > 0.8
    refitted = clone(again).fit(touches)
    assert_allclose(refitted.predict_proba(test), again.predict_proba(test))


def vectors(seed):
    touches = drawn(seed=seed)
    return touches.images.reshape(len(touches), -1), touches.object


def test_feature_vectors_are_touches_without_geometry():
    X, y = vectors(0)
    learnt = ObjectRecogniser().fit(X, y)
    assert learnt.n_features_in_ == 45
    images = Touches(X[:, np.newaxis], object=y, geometry="none")
    as_images = ObjectRecogniser().fit(images)
    assert_array_equal(learnt.predict_proba(X), as_images.predict_proba(images))
    belief = learnt.start()
    for row in vectors(1)[0][:5]:
        belief.update(row)
    assert belief.best == "ball"
    with pytest.raises(ValueError, match="7 features, but ObjectRecogniser is expect"):
        learnt.predict(X[:, :7])


def test_a_recogniser_learns_from_a_data_frame():
    pandas = pytest.importorskip("pandas")
    X, y = vectors(0)
    frame = pandas.DataFrame(X, columns=[f"taxel {k}" for k in range(45)])
    learnt = ObjectRecogniser().fit(frame, y)
    assert learnt.feature_names_in_[2] == "taxel 2"
    of_array = ObjectRecogniser().fit(X, y)
    assert learnt.predict(frame).tolist() == of_array.predict(X).tolist()
    with pytest.raises(ValueError, match="feature names should match"):
        learnt.predict(frame.rename(columns={"taxel 2": "other"}))
    one = learnt.start().update(frame.iloc[0])
    assert one.posterior == of_array.start().update(X[0]).posterior
    with pytest.raises(ValueError, match="must be in the same order"):
        learnt.start().update(frame[frame.columns[::-1]].iloc[0])


def test_a_function_may_be_an_encoding(touches):
    sums = FunctionTransformer(lambda images: images.sum(axis=2))
    learnt = ObjectRecogniser(None, encodings={"sums": sums}).fit(touches)
    assert learnt.memory_.features.shape[1] == 5


def test_the_repr_names_the_objects_and_counts_the_touches(alone):
    text = repr(alone)
    assert "# knows 3 objects (ball, mug, pen) from 42 touches" in text
    assert repr(clone(alone)).startswith("ObjectRecogniser(")
    assert "knows" not in repr(clone(alone))


def test_confusions_are_drawn(alone):
    pytest.importorskip("matplotlib").use("Agg")
    axes = alone.plot_confusion()
    drawn_shares = axes.images[0].get_array()
    assert_allclose(drawn_shares.sum(axis=1), 100)
    left_out = alone.left_out_log_likelihood().argmax(axis=1)
    codes = np.searchsorted(alone.classes_, alone.memory_.labels)
    right = np.mean(left_out == codes)
    assert f"{right:.0%} right" in axes.get_title()
    assert [t.get_text() for t in axes.get_yticklabels()] == NAMES


def test_names_with_dollars_are_drawn_as_they_are():
    """Two of them would be a formula, and one that cannot be read an error."""
    pytest.importorskip("matplotlib").use("Agg")
    touches = drawn()
    costly = np.where(touches.object == "mug", "$^$", touches.object)
    learnt = ObjectRecogniser(None, encodings={"means": Means()})
    learnt.fit(touches.with_columns(object=costly))
    episode = learnt.episode()
    episode.add(touches[touches.object == "mug"][:2])
    for axes in (learnt.plot_confusion(), episode.plot(), episode.belief.plot()):
        axes.figure.draw_without_rendering()


def test_touches_are_drawn(touches):
    pytest.importorskip("matplotlib").use("Agg")
    axes = touches[:5].plot()
    panels = [panel for panel in axes.flat if panel.images]
    assert len(panels) == 5
    assert_array_equal(panels[3].images[0].get_array(), touches.images[3])
    assert len([panel for panel in touches.plot(most=3).flat if panel.images]) == 3
