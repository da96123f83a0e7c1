// Members of the drawing classes that the rest of ORB-SLAM3 calls; nothing is drawn.
#include "MapDrawer.h"
#include "Viewer.h"

namespace ORB_SLAM3 {

MapDrawer::MapDrawer(Atlas *atlas, const std::string &, Settings *) : mpAtlas(atlas) {}
void MapDrawer::SetCurrentCameraPose(const Sophus::SE3f &) {}
void MapDrawer::SetReferenceKeyFrame(KeyFrame *) {}

Viewer::Viewer(System *, FrameDrawer *, MapDrawer *, Tracking *, const std::string &, Settings *) {}
void Viewer::Run() {}
void Viewer::RequestFinish() {}
void Viewer::RequestStop() {}
bool Viewer::isFinished() { return true; }
bool Viewer::isStopped() { return true; }
void Viewer::Release() {}

}  // namespace ORB_SLAM3
