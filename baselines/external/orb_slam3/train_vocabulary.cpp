// Trains a vocabulary of ORB features in the form that ORB-SLAM3 reads.
//
//   train_vocabulary OUT.txt PICTURE... (or - for a list of paths on the standard input)

#include <iostream>
#include <string>
#include <vector>

#include <opencv2/opencv.hpp>

#include "ORBVocabulary.h"
#include "ORBextractor.h"
#include "Thirdparty/DBoW2/DUtils/Random.h"

int main(int argc, char **argv) {
  if (argc < 3) {
    std::cerr << "usage: train_vocabulary OUT.txt PICTURE... (or - for a list of paths on the standard input)" << std::endl;
    return 2;
  }
  std::vector<std::string> paths(argv + 2, argv + argc);
  if (paths == std::vector<std::string>{"-"}) {
    paths.clear();
    for (std::string line; std::getline(std::cin, line);)
      paths.push_back(line);
  }
  ORB_SLAM3::ORBextractor extract(1000, 1.2f, 8, 20, 7);  // upstream's settings for EuRoC
  std::vector<std::vector<cv::Mat>> features;
  for (const std::string &path : paths) {
    const cv::Mat picture = cv::imread(path, cv::IMREAD_GRAYSCALE);
    if (picture.empty()) {
      std::cerr << path << ": not a picture" << std::endl;
      return 1;
    }
    std::vector<cv::KeyPoint> points;
    cv::Mat rows;
    std::vector<int> overlap = {0, 0};
    extract(picture, cv::Mat(), points, rows, overlap);
    features.emplace_back();
    for (int i = 0; i < rows.rows; i++)
      features.back().push_back(rows.row(i).clone());
  }
  DUtils::Random::SeedRandOnce(1);  // the means begin where it says, which else is the time of day
  ORB_SLAM3::ORBVocabulary vocabulary(10, 6, DBoW2::TF_IDF, DBoW2::L1_NORM);  // the published one's
  vocabulary.create(features);
  vocabulary.saveToTextFile(argv[1]);
  std::cout << vocabulary.size() << " words of " << paths.size() << " pictures" << std::endl;
  return 0;
}
