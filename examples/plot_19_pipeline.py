"""
palpate inside scikit-learn
===========================

Encoders are transformers of scikit-learn and recognisers are classifiers, so pipelines,
cross-validation and grid searches take them.
"""

import matplotlib.pyplot as plt
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import simulate_presses
from palpate.encodings import ZernikeMoments

touches = simulate_presses(None, 16, random_state=0)
model = make_pipeline(ZernikeMoments(), StandardScaler(), SVC(C=10))
orders = [2, 3, 4, 6, 8, 10, 12, 15]
search = GridSearchCV(model, {"zernikemoments__order": orders}, cv=4)
search.fit(touches.images, touches.object)
print(search.best_params_, f"{search.best_score_:.0%}")

figure, axes = plt.subplots()
mean = 100 * search.cv_results_["mean_test_score"]
spread = 100 * search.cv_results_["std_test_score"]
axes.errorbar(orders, mean, spread, marker="o", capsize=3)
axes.set(xlabel="order of the Zernike moments", ylabel="right after one press, %")
axes.set_title("Chosen by scikit-learn's GridSearchCV")
