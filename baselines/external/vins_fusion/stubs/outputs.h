// In place of upstream's utility/visualization.h, which publishes to ROS: what its estimator hands out. driver.cpp has them.
#pragma once

#include "estimator.h"

void pubTrackImage(const cv::Mat &picture, const double t);
void pubLatestOdometry(const Eigen::Vector3d &P, const Eigen::Quaterniond &Q, const Eigen::Vector3d &V, double t);
void printStatistics(const Estimator &estimator, double t);
void pubOdometry(const Estimator &estimator, const std_msgs::Header &header);
void pubKeyPoses(const Estimator &estimator, const std_msgs::Header &header);
void pubCameraPose(const Estimator &estimator, const std_msgs::Header &header);
void pubPointCloud(const Estimator &estimator, const std_msgs::Header &header);
void pubKeyframe(const Estimator &estimator);
void pubTF(const Estimator &estimator, const std_msgs::Header &header);
